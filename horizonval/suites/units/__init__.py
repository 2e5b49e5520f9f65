"""Units of a suite: work of one worker at a time, rendered or read from an archive, then scored."""
