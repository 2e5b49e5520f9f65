"""What single gases absorb and scatter."""
