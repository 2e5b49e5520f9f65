"""Estimators in processes of their own, foreign programs included."""
