"""The picture of docs/howto/spacecraft-parts.md: python docs/make_parts.py results/gallery/parts.jpg

The shipped scenes with parts of the spacecraft in view, three in colours of visible light, one in the infrared.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import make_limbs
import numpy as np
from make_limbs import GAP, HEIGHT, WIDTH, infrared, visible

VISIBLE = ("part-antenna", "part-glint", "part-baffle")
INFRARED = ("part-hot-panel", "lwir")


def main(path: Path) -> None:
    """Write the picture; single scattering and few rays on the parts serve."""
    make_limbs.QUICK |= {"orders": "single", "part_samples": 16}
    pictures = [visible(name) for name in VISIBLE] + [infrared(*INFRARED)]
    whole = np.full((2 * HEIGHT + GAP, 2 * WIDTH + GAP, 3), 255, np.uint8)
    for i, picture in enumerate(pictures):
        top, left = (i // 2) * (HEIGHT + GAP), (i % 2) * (WIDTH + GAP)
        whole[top : top + HEIGHT, left : left + WIDTH] = picture
    cv2.imwrite(str(path), whole[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
