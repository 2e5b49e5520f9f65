"""Servers: images for a simulation in the loop, and a report in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from horizonval.cli.options import shipped
from horizonval.core.errors import UserError

if TYPE_CHECKING:
    from horizonval.wire import Address


def serve(
    scene: Annotated[
        str, typer.Option(help="A scene file, or the name of a shipped scene.", autocompletion=shipped("scene"))
    ],
    socket: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Unix socket; by default one in this user's runtime folder.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="TCP on the loopback in its place; 0 is any port that is free.")
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="With --port: another address to listen at; other machines need a token.")
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Holds a word that every request must carry.")
    ] = None,
    once: Annotated[int | None, typer.Option(min=1, metavar="N", help="Stop after N images.")] = None,
    time_limit: Annotated[
        float, typer.Option(min=0.1, max=3600.0, help="Seconds that a message may take to come in or go out.")
    ] = 30.0,
) -> None:
    """Images for a simulation: pose in, image out, with truth; until it is interrupted.

    Each request gives position, attitude and exposure; missing values come from the scene. The same request gives the
    bytes of `render` and `observe`. See hv.Client, and examples/serve for C.
    """
    from horizonval.jobs.pool import hush
    from horizonval.serve.service import serve as served
    from horizonval.wire import Address

    if socket is not None and port is not None:
        raise UserError("used with --port", where="--socket", expected="one of the two")
    if host is not None and port is None:
        raise UserError("used without --port", where="--host")
    address = Address.parse("") if port is None else Address(None, host or "127.0.0.1", port)
    if socket is not None:
        address = Address(socket)

    def ready(reached: Address, about: dict[str, Any]) -> None:
        hush()
        bands = ", ".join(about["bands"])
        print(
            f"{reached}: {about['scene']}, {about['camera']}, {about['width']} x {about['height']}, {bands}", flush=True
        )

    images = served(scene, address, token_file=token_file, most_images=once, time_limit_s=time_limit, ready=ready)
    print(f"{images} images served")


def view(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a run, campaign, study or night.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="On the loopback; 0 is any that is free.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
) -> None:
    """Report in a browser, served on this machine alone; until it is interrupted.

    Every frame of a run is available with its exact numbers, read from the archive on request, including those that a
    long run's page leaves out.
    """
    from horizonval.jobs.pool import hush
    from horizonval.report.view_server import view as served
    from horizonval.report.view_server import viewable

    def ready(address: str) -> None:
        hush()
        print(f"{address} (Ctrl-C ends it)", flush=True)
        if not no_browser:
            _open_browser(address)

    served(viewable(out), port, ready)
    print("ended")


def _open_browser(address: str) -> None:
    """Open a graphical browser if there is a display: a terminal browser would take over the terminal."""
    import os
    import sys
    import webbrowser

    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)
