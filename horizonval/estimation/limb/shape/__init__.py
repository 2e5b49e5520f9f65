"""The shapes that limb points are fitted with: a circle in the image, a cone of directions."""
