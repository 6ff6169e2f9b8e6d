"""The panel's server: its socket, its certificate, and the process until Ctrl-C."""

from __future__ import annotations

import errno
import logging
import socket
import ssl
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from rig.panel.access import AccessError, Address
from rig.panel.app import Panel, make_app
from rig.panel.sockets import LARGEST_MESSAGE, PING_EVERY_S, PONG_WITHIN_S, CountedProtocol, Door, MeteredProtocol

_BACKLOG = 128
_SEND_BUFFER = 32 * 1024  # small, so that a page that reads slowly gets new rows, not old ones from a buffer


@dataclass(frozen=True)
class Certificate:
    """For TLS: the files of the certificate with its chain, and of its key, in PEM."""

    chain: Path
    key: Path


def listen(bind: str, port: int) -> Door:
    """The socket that the panel is served on. Raises AccessError if the address is taken, or not this machine's."""
    family = socket.AF_INET6 if ":" in bind else socket.AF_INET
    listening = Door(family)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        listening.bind((bind, port))
        listening.listen(_BACKLOG)
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise AccessError(
                f"port {port} of {bind} is taken", "another rig panel? Use that one, or give another --port"
            ) from error
        raise AccessError(f"{bind}:{port} cannot be served on: {error.strerror}", "check --bind and --port") from error
    return listening


def require_certificate(certificate: Certificate) -> None:
    """Raise AccessError if certificate and key cannot be read, or do not belong together."""
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate.chain, certificate.key)
    except (OSError, ssl.SSLError) as error:
        raise AccessError(
            f"{certificate.chain} with {certificate.key}: {error.strerror or error}",
            "give --tls-cert and --tls-key as PEM files that belong together, without a passphrase",
        ) from error


def serve(panel: Panel, listening: Door, certificate: Certificate | None = None) -> None:
    """Serve until Ctrl-C or SIGTERM. Runs that go on are left alone."""
    log = logging.getLogger("uvicorn.error")
    log.setLevel(logging.ERROR)
    log.addFilter(lambda record: "CancelledError" not in record.getMessage())  # a second Ctrl-C is no error
    config = uvicorn.Config(
        make_app(panel),
        log_config=None,
        access_log=False,
        loop="asyncio",  # others accept connections past the door
        http=CountedProtocol.behind(listening),
        ws=MeteredProtocol,
        ws_max_size=LARGEST_MESSAGE,
        ws_ping_interval=PING_EVERY_S,
        ws_ping_timeout=PONG_WITHIN_S,
        ws_per_message_deflate=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=1,
        ssl_certfile=None if certificate is None else str(certificate.chain),
        ssl_keyfile=None if certificate is None else str(certificate.key),
    )
    uvicorn.Server(config).run(sockets=[listening])


def address_of(listening: socket.socket, bind: str, *, secure: bool, names: tuple[str, ...]) -> Address:
    """The address of a socket that listens: with port 0 the system has chosen one."""
    return Address(bind, listening.getsockname()[1], secure, names)
