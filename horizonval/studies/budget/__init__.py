"""Pointing budgets: which error source contributes how much to the knowledge error of a sensor."""
