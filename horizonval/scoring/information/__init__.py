"""What the pixels of an image say about the pose it was taken from: Fisher information, from the truth alone."""
