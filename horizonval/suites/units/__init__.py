"""Units of a suite: what one worker makes at once, rendered or read from an archive, scored alike."""
