"""Hands an image, its camera and what is known beside it to limb_fit: python adapter.py {image} {camera} {prior}"""

import subprocess
import sys
import tomllib
from datetime import UTC
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.earth.atmosphere.climate import month_of
from horizonval.geometry.sun_and_moon import sun_itrs

BLUR_PX, BLUR_LOG_SIGMA, LIFT_SIGMA_M = 0.7, 0.3, 300.0
# The camera's file does not say what a digital number stands for.
GAIN, NOT_CALIBRATED = 1.0, 0.0
# Nor at what it is saturated: none below the largest number of 16 bits.
FULL_SCALE = 65535.0

image = cv2.imread(sys.argv[1], cv2.IMREAD_UNCHANGED)
camera = tomllib.loads(Path(sys.argv[2]).read_text())["camera"]
# limb_fit.c knows fx, fy, cx and cy only.
if camera.get("projection", "pinhole") != "pinhole" or any(camera.get("distortion", [])) or camera.get("skew"):
    sys.exit("limb_fit takes a pinhole without distortion and skew, not this camera")
prior = tomllib.loads(Path(sys.argv[3]).read_text())["prior"]
epoch = prior["epoch_utc"]
attitude = prior["q_cam_from_itrs"]
towards_sun = sun_itrs(epoch)[0]
numbers = [
    *(camera[key] for key in ("width", "height", "fx", "fy", "cx", "cy")),
    *(1e3 * x for x in prior["position_itrs_km"]),
    1e3 * prior["position_sigma_km"],
    *attitude,
    np.radians(max(prior["attitude_sigma_deg"])),
    month_of(epoch if epoch.tzinfo else epoch.replace(tzinfo=UTC)),
    *Rotation.from_quat(attitude).apply(towards_sun),
    *towards_sun,
    *(BLUR_PX, BLUR_LOG_SIGMA, LIFT_SIGMA_M, GAIN, NOT_CALIBRATED, FULL_SCALE),
]
line = " ".join(f"{x:.17g}" for x in numbers) + "\n"
program = Path(__file__).with_name("limb_fit")
subprocess.run([program], input=line.encode() + image.astype("uint16").tobytes(), check=True)
