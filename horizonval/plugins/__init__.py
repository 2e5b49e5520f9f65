"""Estimators by name, and how third-party code runs: in supervised processes, found without being imported.

=================  ======================================================================================
``registry``       names from the entry points of installed packages; running one safely in this process
``supervisor``     the worker's side: processes, their limits of time and memory, crashes as outcomes
``child``          the other side: the program that runs estimators for a worker
``messages``       messages between the two: observations as objects, answers as plain data
``answer``         the form of an answer, its rounding, and the record of a crash
``program``        ``command = "..."``: any program as an estimator
``onnx_model``     a network in an ONNX file as an estimator
=================  ======================================================================================
"""
