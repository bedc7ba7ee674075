"""A viser server on this machine alone: bound to 127.0.0.1, on a free port, without viser's own output.

Any page in a browser may open a websocket to this machine. The server refuses those of pages from other places, which
would else see the map and change the plan.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any

from hdsp.base.errors import InputError

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"
#: Port of the viewer, and the number of ports after it that are tried.
PORT, _TRIED = 8080, 20
#: Pages that may open a websocket: those of this machine on any port, because a tunnel has its own, and programs, which
#: name no page.
_ORIGINS = re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?"), None
_OPENING = Lock()


def viser_module() -> Any:
    """Returns the module viser.

    Raises:
        InputError: viser is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "viser":
            raise
        raise InputError("the viewer needs viser: pip install 'hdsp[view]'") from error
    return viser


def free_port(port: int = PORT) -> int:
    """Returns the first free port from ``port`` on; 0: any free port.

    Raises:
        InputError: ``port`` is no port, or this and the following ports are busy.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"port {port}: need a number from 0 to 65535")
    for candidate in range(port, min(port + _TRIED, 65536)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as attempt:
            attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                attempt.bind((HOST, candidate))
            except OSError:
                continue
            return int(attempt.getsockname()[1])
    last = min(port + _TRIED, 65536) - 1
    raise InputError(f"port {port}: it and all ports up to {last} are busy or not allowed; choose another one")


def open_server(port: int = PORT) -> viser.ViserServer:
    """Starts a server for browsers on this machine.

    Args:
        port: as for `free_port`.

    Raises:
        InputError: viser is not installed, or no port is free.
    """
    viser = viser_module()
    port = free_port(port)
    with _silent(), _own_pages_alone():
        server = viser.ViserServer(host=HOST, port=port, label="hdsp", verbose=False)
    server.request_share_url = _refuse  # type: ignore[method-assign]
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.scene.set_up_direction("+z")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Ends a server; browsers keep the last picture."""
    with _silent():
        server.stop()


@contextmanager
def _silent() -> Iterator[None]:
    """Suppresses what viser prints: a table of addresses at the start, a line at the end."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


@contextmanager
def _own_pages_alone() -> Iterator[None]:
    """Lets servers that start in this block refuse websockets of other pages; viser has no setting for this."""
    from websockets.asyncio import server

    with _OPENING:
        before = server.serve
        server.serve = partial(before, origins=_ORIGINS)  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            server.serve = before  # type: ignore[misc]


def _refuse(verbose: bool = True) -> None:
    """Answers a browser's request for a public address: there is none."""


def address(server: viser.ViserServer) -> str:
    """Returns the address of a server for a browser."""
    return f"http://{HOST}:{server.get_port()}"
