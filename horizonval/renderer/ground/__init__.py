"""The ground of a frame as the kernel has it."""
