"""Print what the renderer's thermal radiance is of LOWTRAN7's and REPTRAN's, every interval and height.

    python tests/physics/make_thermal_ratios.py [CLIMATE ...]

All at 330 ppm of CO2. Why they depart (US standard atmosphere where figures are given):

- 14.0 to 16.3 um up to 26 km, 1 to 5 %: its middle (band 4) agrees within 2 %; the rest is 700 to 714 cm-1, where the
  table is 8 % brighter at the ground and 14 % darker on the limb than LOWTRAN7, 3 to 7 % darker than REPTRAN.
- 28 to 46 km: up to 15 % darker than LOWTRAN7, up to 12 % brighter than REPTRAN. Lines are narrow there, and the two
  peers, of 20 and 15 cm-1 resolution, disagree by 30 % between themselves at 40 km.
- Above 46 km: LOWTRAN7 has no Doppler broadening and too little absorption at low pressure, REPTRAN likewise from 60 km
  on: ratios of 2 to 10 say nothing against the table. Above 75 km there is no local thermodynamic equilibrium.
- 8 to 14 um from 8 to 30 km, up to 11 % darker: ozone itself (band 7) agrees within 2 % up to 24 km; it is 714 to 980
  cm-1 (bands 5 and 6) that is darker.
- 10.5 to 12.5 um above 8 km, 10 to 30 % darker up to 28 km: less than 0.5 W m-2 sr-1; which part of its g points lies
  in the window is known no better.
- 500 to 630 cm-1 (band 3), 10 to 13 % darker from 18 to 28 km: not explained; no third peer covers it.
- 1080 to 1390 cm-1 (bands 8 and 9): brighter from 24 km on, N2O and CH4 at low pressure.
- Nadir: within 1.3 K but for 700 to 820 cm-1 (+3 K), of which 14.0 to 16.3 um has its share (+2 K).
"""

from __future__ import annotations

import sys

import numpy as np
from test_thermal_table import IN_FILE, INTERVALS, RADIUS_M, heights_m, ours, table


def main(climates: tuple[str, ...]) -> None:
    """Print a table per climate and peer."""
    for climate in climates:
        for peer in ("lowtran7", "reptran"):
            expected = {name: table(climate, name, f"{peer}_330ppm_W_m2_sr") for name in INTERVALS}
            shown = [name for name in INTERVALS if np.any(np.isfinite(expected[name]))]
            print(f"\n{climate}, 330 ppm of CO2: ours / {peer}\n{'km':>6}" + "".join(f"{name:>14}" for name in shown))
            for i, z in enumerate(heights_m()):
                ratios = [ours(climate, 330)[name][i] / expected[name][i] for name in shown]
                if np.any(np.isfinite(ratios)):
                    height = "nadir" if z == -RADIUS_M else f"{z / 1e3:g}"
                    print(f"{height:>6}" + "".join(f"{r:14.3f}" if np.isfinite(r) else f"{'':>14}" for r in ratios))


if __name__ == "__main__":
    main(tuple(sys.argv[1:]) or IN_FILE)
