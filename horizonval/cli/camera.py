"""Cameras of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.checks import check_target
from horizonval.cli.options.completion import shipped


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
        typer.Option(metavar="CSV", help="Table of field_deg and relative_illumination, or vignetting."),
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
