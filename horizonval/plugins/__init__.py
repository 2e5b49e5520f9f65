"""Estimators by name, and how code of other people is run: in supervised processes, found without being imported.

=================  ======================================================================================
``registry``       names from the entry points of installed packages; running one safely in this process
``supervisor``     a worker's side: processes, their limits of time and memory, a crash as an outcome
``child``          the other side: the program that runs estimators for a worker
``messages``       what passes between the two: observations as objects, answers as plain data
``program``        ``command = "..."``: any program as an estimator
=================  ======================================================================================
"""
