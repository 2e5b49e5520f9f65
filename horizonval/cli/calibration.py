"""Cameras calibrated: in orbit, and by other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.checks import check_target
from horizonval.cli.options import Json
from horizonval.cli.options.completion import files, shipped
from horizonval.cli.printing import print_json
from horizonval.cli.work import watched


def calibrate(
    images: Annotated[
        list[Path],
        typer.Argument(help="Images of one camera, or folders of runs with an archive."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Camera file to write; the --camera of estimates."),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(help="Camera as it is believed; our own files carry theirs.", autocompletion=shipped("camera")),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="File of a table [prior] with sigmas of position and attitude, in place of what the files say.",
            autocompletion=files(".toml"),
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """Focal length, principal point and mounting from the limbs in the images of a pass.

    Needs position and attitude beside every image, as the platform states them. Where the images do not determine the
    focal length, it is a refusal with its reason: no file is written, and the exit status is 1.
    """
    from horizonval.commands.calibrate import calibrated, observations_of
    from horizonval.commands.estimate import prior_from
    from horizonval.core.atomic import write_text
    from horizonval.spec.load import load_camera

    if out is not None:
        check_target(out)
    spec = load_camera(camera) if camera is not None else None
    known = prior_from(prior) if prior is not None else None
    with watched("calibrate", "images") as progress:
        report, text = calibrated(observations_of(images, spec, camera or "", known), progress)
    if out is not None and text is not None:
        write_text(out, text)
    if as_json:
        print_json(report)
    else:
        for key, value in report.items():
            print(f"{key:28} {value}")
    return 0 if text is not None else 1


def camera(
    file: Annotated[Path, typer.Argument(help="ROS camera_info, Kalibr camchain, OpenCV or MATLAB (JSON) file.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Camera file to write; without, it is printed.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            help="Camera of ours whose bands, optics and detector it takes.", autocompletion=shipped("camera")
        ),
    ] = None,
    vignetting: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Table of field_deg or radius_px, and relative_illumination or vignetting."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--camera", help="Of several cameras in one file of Kalibr, as cam0.")
    ] = None,
) -> None:
    """A camera file from that of a calibration program: the lens, exactly, or why ours cannot be that lens.

    Without --base the file says the lens alone, which is what `horizonval estimate --camera` needs.
    """
    from horizonval.commands.camera_file import camera_text
    from horizonval.core.atomic import write_text

    if out is not None:
        check_target(out, file)
    text = camera_text(file, name, base, vignetting)
    if out is None:
        print(text, end="")
    else:
        write_text(out, text)
