"""A scene served at an address until a signal comes."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from horizonval.serve.images import ImageSource
from horizonval.serve.listener import check_reach, listening, read_token
from horizonval.serve.server import Server
from horizonval.wire.address import Address
from horizonval.wire.packing import check_installed


def serve(
    scene: str | Path,
    address: Address,
    *,
    token_file: Path | None = None,
    most_images: int | None = None,
    time_limit_s: float = 30.0,
    ready: Callable[[Address, dict[str, Any]], None],
) -> int:
    """Serve images of a scene; return how many were made, after SIGINT, SIGTERM or the last one asked for.

    Parameters
    ----------
    scene : str or Path
        A scene file or the name of a shipped one.
    address : Address
        Unix socket or TCP; port 0 is any that is free.
    token_file : Path, optional
        Holds a word that clients must know; needed where other machines can reach the address.
    most_images : int, optional
        Stop after so many.
    time_limit_s : float
        For a message to come in or to go out, each.
    ready : callable
        Told of the address and of what is served once the first image can be asked for.

    Raises
    ------
    UserError
        A scene that cannot be rendered or observed, an address that is taken or reaches too far, a missing package.
    """
    check_installed()
    token = None if token_file is None else read_token(token_file)
    check_reach(address, token)
    source = ImageSource(scene)
    with _ended_by_signals() as check_signals, listening(address) as (listener, reached):
        # What the scene cannot do is said now, and the tables of its place are there for the first client.
        source.first_image()
        check_signals()
        server = Server(source.answer, source.about(), token=token, time_limit_s=time_limit_s, most_images=most_images)
        with _stopped_by_signals(server.stop):
            ready(reached, source.about())
            server.run(listener)
    return server.served


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[Callable[[], None]]:
    """Let SIGTERM end a start as SIGINT does, so that no socket stays behind.

    Yields what raises once more, later, what a signal has raised: an exception that comes while compiled code calls
    back, or while Python tidies up, goes no further, and the start would go on.
    """
    asked = threading.Event()

    def check_signals() -> None:
        if asked.is_set():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield check_signals
        return

    def handle(_kind: int, _frame: object) -> None:
        asked.set()
        raise KeyboardInterrupt

    before = {kind: signal.signal(kind, handle) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check_signals
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


@contextlib.contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Let SIGINT and SIGTERM stop in an orderly way; a second one does what it does without us."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for kind, handler in before.items():
            signal.signal(kind, handler)

    def handle(_kind: int, _frame: object) -> None:
        restore()
        stop()

    for kind in before:
        signal.signal(kind, handle)
    try:
        yield
    finally:
        restore()
