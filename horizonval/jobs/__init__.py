"""Engine of long work: processes, stored results, resumption after an interruption."""
