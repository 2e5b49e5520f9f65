"""Studies over many frames: trade studies, nightly regression."""
