"""Who may watch, and who may drive: token, cookie, password, Host, Origin, security headers. No I/O.

Whoever reaches the panel's address may watch and stop. To drive, a browser needs a session. It gets one for the token
in the start URL, which works once, or for the password. Every request must name the panel's own host, so no other
name that was made to point here reads anything (DNS rebinding). What changes something must come from the panel's own
page, so no other site's page acts in a user's name.
"""

from __future__ import annotations

import base64
import binascii
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Final, Literal

from rig.core.errors import CauseError
from rig.panel.messages import RefusedError

Kind = Literal["read", "write", "socket"]
RawHeaders = Iterable[tuple[bytes, bytes]]

LEAST_PASSWORD: Final = 12  # letters
_MOST_SESSIONS: Final = 64  # of a password; the oldest is forgotten
_WRONG_PASSWORD_COSTS_S: Final = 1.0
_MOST_WRONG: Final = 256  # addresses that gave a wrong password within that time; more: all are told to wait
_DEFAULT_PORTS: Final = {"http": 80, "https": 443}

_PAGE_POLICY: Final = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-src 'self'; frame-ancestors 'none'"
)
# A report is a file from a run folder, which anybody may have written: no script, no form, no origin.
_REPORT_POLICY: Final = (
    "sandbox; default-src 'none'; img-src data:; style-src 'unsafe-inline'; font-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)


class AccessError(CauseError):
    """The panel may not be served in this way."""


@dataclass(frozen=True)
class Address:
    """Where the panel is served.

    bind    the interface's address, such as 127.0.0.1
    port    1 to 65535
    secure  whether over TLS
    names   other host names by which users call this address, such as that in the certificate
    """

    bind: str
    port: int
    secure: bool = False
    names: tuple[str, ...] = ()

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        if self.bind == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.bind).is_loopback
        except ValueError:
            return False

    @property
    def scheme(self) -> str:
        """Of its URLs: http or https."""
        return "https" if self.secure else "http"

    @property
    def hosts(self) -> tuple[str, ...]:
        """The values of the header Host that mean this panel; the first is for its URL."""
        own = [*self.names, f"[{self.bind}]" if ":" in self.bind else self.bind]
        if self.is_loopback:
            own.append("localhost")
        if self.port == _DEFAULT_PORTS[self.scheme]:  # browsers leave it out
            return (*own, *(f"{host}:{self.port}" for host in own))
        return tuple(f"{host}:{self.port}" for host in own)

    @property
    def url(self) -> str:
        """The panel's address for a browser."""
        return f"{self.scheme}://{self.hosts[0]}/"


def require_safe(address: Address, *, password: bool) -> None:
    """Raise AccessError if others on the network could drive the bench, or read along.

    password  whether there is one
    """
    try:
        anywhere = ipaddress.ip_address(address.bind).is_unspecified
    except ValueError:
        if address.bind != "localhost":
            raise AccessError(
                f"--bind {address.bind!r} is no address", "give that of an interface, such as 192.168.1.20"
            ) from None
        anywhere = False
    if address.is_loopback:
        return
    if not address.secure or not password:
        raise AccessError(
            f"--bind {address.bind} lets the network reach the bench: that needs TLS and a password",
            "give --tls-cert, --tls-key and --password-file; or leave --bind out and tunnel: "
            f"ssh -L {address.port}:127.0.0.1:{address.port} THIS-MACHINE",
        )
    if anywhere and not address.names:
        raise AccessError(
            f"--bind {address.bind} has no name of its own, and the panel answers only to its own",
            "name the machine as users type it: --name bench.example.org",
        )


def password_of(text: str) -> str:
    """The password in a password file: its only line. Raises AccessError if it is too short."""
    password = text.rstrip("\r\n")
    if len(password) < LEAST_PASSWORD or "\n" in password:
        raise AccessError(
            f"the password file must have one line of at least {LEAST_PASSWORD} letters",
            "make one: python3 -c 'import secrets; print(secrets.token_urlsafe(18))' > FILE; chmod 600 FILE",
        )
    return password


class Access:
    """The sessions of one panel, and who of them is the operator.

    token  for the start URL: worth one session, once; None if a password gives sessions
    """

    def __init__(
        self, address: Address, password: str | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.address = address
        self.token: str | None = secrets.token_urlsafe(24) if password is None else None
        self.cookie = f"rig_panel_{address.port}"  # cookies of one host are shared by all its ports
        self._password = password
        self._clock = clock
        self._sessions: list[str] = []
        self._operator: str | None = None
        self._closed_until_s: dict[str, float] = {}  # by address
        self._hosts = frozenset(address.hosts)
        self._origins = frozenset(f"{address.scheme}://{host}" for host in address.hosts)

    @property
    def has_password(self) -> bool:
        """Whether a page is shown only to those who know the password."""
        return self._password is not None

    # ------------------------------------------------------------------ requests

    def refusal(self, kind: Kind, raw: RawHeaders) -> RefusedError | None:
        """Why a request with these headers is not ours to answer; None if it is.

        What reads must be of our host, and not fetched by another site's page. What writes, and the WebSocket, must be
        of our host and of our origin.
        """
        headers = list(raw)
        hosts = _all(headers, b"host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return RefusedError(
                421, "this is the panel of another address", f"open {self.address.url} (`rig panel` prints it)"
            )
        if kind != "read":
            origins = _all(headers, b"origin")
            if len(origins) != 1 or origins[0] not in self._origins:
                return RefusedError(
                    403, "this request comes from another site's page", f"use {self.address.url} itself"
                )
        elif _is_fetched_by_another_site(headers):
            return RefusedError(403, "this request comes from another site's page", f"open {self.address.url} itself")
        return None

    # ------------------------------------------------------------------ sessions

    def redeem(self, token: str) -> str | None:
        """A new session for the token. None if it is another one, or was used before."""
        if self.token is None or not hmac.compare_digest(token.encode(), self.token.encode()):
            return None
        self.token = None
        return self._new_session()

    def log_in(self, authorization: str, peer: str = "") -> str | RefusedError:
        """A new session for a header Authorization with the password; the user's name does not matter.

        peer  the address that it came from: after a wrong password this address waits, and no other one
        """
        given = _basic_password(authorization)
        if given is not None:
            now_s, who = self._clock(), _neighbourhood(peer)
            self._closed_until_s = {one: until_s for one, until_s in self._closed_until_s.items() if now_s < until_s}
            if who in self._closed_until_s or len(self._closed_until_s) >= _MOST_WRONG:
                return RefusedError(429, "a wrong password was given a moment ago", "wait a second, then try again")
            if self._password is not None and hmac.compare_digest(given, self._password.encode()):
                return self._new_session()
            self._closed_until_s[who] = now_s + _WRONG_PASSWORD_COSTS_S
        return RefusedError(401, "the panel asks for its password", "it is in the file that --password-file names")

    def session_of(self, raw: RawHeaders) -> str | None:
        """The session that a request's cookie names; None if there is none such."""
        for text in _all(raw, b"cookie"):
            try:
                cookie = SimpleCookie(text).get(self.cookie)
            except CookieError:
                continue
            if cookie is not None and cookie.value in self._sessions:
                return cookie.value
        return None

    def set_cookie(self, session: str) -> str:
        """The header Set-Cookie: no script reads it, and no other site's page makes a browser send it."""
        secure = "; Secure" if self.address.secure else ""
        return f"{self.cookie}={session}; Path=/; HttpOnly; SameSite=Strict{secure}"

    # ------------------------------------------------------------------ the operator

    def take(self, session: str | None) -> bool:
        """Make a session the operator's. False if it is no session: it may only watch and stop."""
        if session is None or session not in self._sessions:
            return False
        self._operator = session
        return True

    def is_operator(self, session: str | None) -> bool:
        """Whether this session drives."""
        return session is not None and session == self._operator

    def _new_session(self) -> str:
        session = secrets.token_urlsafe(24)
        self._sessions = [*self._sessions[1 - _MOST_SESSIONS :], session]
        if self._operator not in self._sessions:
            self._operator = session
        return session


def security_headers(*, report: bool = False) -> list[tuple[bytes, bytes]]:
    """What every answer says to the browser: run nothing that is not ours, tell nobody, let nobody frame us.

    report  the stricter policy of a run's report.html
    """
    return [
        (b"content-security-policy", (_REPORT_POLICY if report else _PAGE_POLICY).encode()),
        (b"x-content-type-options", b"nosniff"),
        (b"referrer-policy", b"no-referrer"),
        (b"cross-origin-opener-policy", b"same-origin"),
        (b"cross-origin-resource-policy", b"same-origin"),
        (b"permissions-policy", b"camera=(), microphone=(), geolocation=(), usb=(), serial=()"),
        (b"cache-control", b"no-store"),
    ]


def _all(headers: RawHeaders, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in headers if key.lower() == name]


def _is_fetched_by_another_site(headers: Collection[tuple[bytes, bytes]]) -> bool:
    """By what browsers say of it. They say it of every fetch; a link that a user follows is no fetch."""
    site = _all(headers, b"sec-fetch-site")
    if not site or site[0] in ("same-origin", "none"):
        return False
    followed = _all(headers, b"sec-fetch-mode") == ["navigate"] and _all(headers, b"sec-fetch-dest") == ["document"]
    return not followed


def _neighbourhood(peer: str) -> str:
    """Of an IPv6 address its network, of which one machine has all addresses; else the address itself."""
    try:
        address = ipaddress.ip_address(peer.partition("%")[0])
    except ValueError:
        return peer
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is None:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return peer


def _basic_password(authorization: str) -> bytes | None:
    kind, _, encoded = authorization.partition(" ")
    if kind.lower() != "basic":
        return None
    try:
        return base64.b64decode(encoded, validate=True).partition(b":")[2]
    except (binascii.Error, ValueError):
        return None
