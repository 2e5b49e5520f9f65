"""Rivals of horizonval's own methods, each in a file of its own, as estimators that a suite names beside ours.

They share no code with the product but the form of its questions and answers: every one has its own search for the
limb, its own camera and its own fit. None is imported before it is asked for, so that a peer that is not installed is
missed by its own estimators alone.
"""
