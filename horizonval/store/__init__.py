"""Files that outlive the process: the EXR gate, the content-addressed archive and its index, the folder of a run."""
