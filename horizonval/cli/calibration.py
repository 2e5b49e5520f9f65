"""A camera calibrated in orbit."""

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
