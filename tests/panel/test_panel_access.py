"""Who may watch, and who may drive."""

from __future__ import annotations

import base64

import pytest

from rig.panel.access import Access, AccessError, Address, password_of, require_safe
from rig.panel.messages import RefusedError

HERE = Address("127.0.0.1", 8470)
HOST = (b"host", b"127.0.0.1:8470")
ORIGIN = (b"origin", b"http://127.0.0.1:8470")


def status(access: Access, kind: str, *headers: tuple[bytes, bytes]) -> int | None:
    refusal = access.refusal(kind, headers)  # type: ignore[arg-type]
    return None if refusal is None else refusal.status


@pytest.mark.parametrize(
    "host",
    [
        b"evil.example",
        b"127.0.0.1",
        b"127.0.0.1:8471",
        b"127.0.0.1.evil.example:8470",
        b"localhost.:8470",
        b"",
        b"LOCALHOST:8470 ",
    ],
)
def test_another_host_is_turned_away_whatever_it_asks(host: bytes) -> None:
    """DNS rebinding: another name that was made to point here."""
    access = Access(HERE)
    for kind in ("read", "write", "socket"):
        assert status(access, kind, (b"host", host), ORIGIN) == 421
    assert status(access, "read") == 421
    assert status(access, "read", HOST, HOST) == 421
    assert status(access, "read", (b"Host", b"localhost:8470")) is None


@pytest.mark.parametrize(
    "origin",
    [
        b"http://evil.example",
        b"null",
        b"http://127.0.0.1:8471",
        b"https://127.0.0.1:8470",
        b"http://127.0.0.1:8470.evil.example",
        b"",
    ],
)
def test_what_changes_something_must_come_from_our_own_page(origin: bytes) -> None:
    access = Access(HERE)
    for kind in ("write", "socket"):
        assert status(access, kind, HOST, (b"origin", origin)) == 403
        assert status(access, kind, HOST) == 403
        assert status(access, kind, HOST, ORIGIN, (b"origin", origin)) == 403
        assert status(access, kind, HOST, ORIGIN) is None


def test_another_sites_page_fetches_nothing_but_a_link_is_followed() -> None:
    access = Access(HERE)

    def read(site: bytes, mode: bytes, dest: bytes) -> int | None:
        said = ((b"sec-fetch-site", site), (b"sec-fetch-mode", mode), (b"sec-fetch-dest", dest))
        return status(access, "read", HOST, *said)

    assert read(b"cross-site", b"no-cors", b"script") == 403
    assert read(b"same-site", b"cors", b"empty") == 403  # a page on another port of this machine
    assert read(b"cross-site", b"navigate", b"iframe") == 403
    assert read(b"cross-site", b"navigate", b"document") is None
    assert read(b"same-origin", b"cors", b"empty") is None
    assert read(b"none", b"navigate", b"document") is None


def test_a_token_works_once_and_its_session_drives_until_another_takes_the_bench() -> None:
    access = Access(HERE)
    token = access.token or ""
    assert len(token) >= 32
    assert access.redeem("") is None
    assert access.redeem(token[:-1] + ("a" if token[-1] != "a" else "b")) is None
    assert access.redeem("тайна") is None
    session = access.redeem(token)
    assert session is not None
    assert access.redeem(token) is None, "used before"
    assert access.is_operator(session)
    assert not access.is_operator(None)
    assert not access.take("made up")
    assert access.is_operator(session)


def test_the_cookie_is_strict_and_only_ours_is_a_session() -> None:
    access = Access(HERE)
    session = access.redeem(access.token or "") or ""
    cookie = access.set_cookie(session)
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(cookie.split("; "))
    sent = cookie.partition(";")[0]
    assert access.session_of([(b"cookie", f"other=1; {sent}".encode())]) == session
    for foreign in (sent[:-1], f"rig_panel_9={session}", "rig_panel_8470=", "\x00=;;=", 'rig_panel_8470="\\'):
        assert access.session_of([(b"cookie", foreign.encode())]) is None


def test_a_password_gives_sessions_and_a_wrong_one_costs_time() -> None:
    now_s = 0.0
    access = Access(Address("192.168.1.5", 443, secure=True), "correct horse battery", lambda: now_s)
    assert access.token is None
    assert access.redeem("") is None

    def log_in(password: str) -> str | RefusedError:
        return access.log_in("Basic " + base64.b64encode(f"anybody:{password}".encode()).decode())

    first = log_in("correct horse battery")
    assert isinstance(first, str)
    assert "Secure" in access.set_cookie(first).split("; ")
    second = log_in("correct horse battery")
    assert isinstance(second, str)
    assert access.is_operator(first)
    assert access.take(second)
    assert not access.is_operator(first)
    wrong = log_in("correct horse batterx")
    assert isinstance(wrong, RefusedError)
    assert wrong.status == 401
    at_once = log_in("correct horse battery")
    assert isinstance(at_once, RefusedError)
    assert at_once.status == 429
    now_s = 1.1
    assert isinstance(log_in("correct horse battery"), str)
    for header in ("", "Basic", "Basic !!!", "Bearer x"):
        assert isinstance(access.log_in(header), RefusedError)


def test_who_guesses_passwords_keeps_nobody_else_out() -> None:
    """A wrong password makes its own address wait, of IPv6 its whole network; and never who has a session."""
    now_s = 0.0
    access = Access(Address("192.168.1.5", 443, secure=True), "correct horse battery", lambda: now_s)

    def log_in(password: str, peer: str) -> str | int:
        found = access.log_in("Basic " + base64.b64encode(f"me:{password}".encode()).decode(), peer)
        return found.status if isinstance(found, RefusedError) else found

    guesser, network = "192.168.1.66", "2001:db8:0:1:"
    assert log_in("wrong", guesser) == 401
    assert log_in("correct horse battery", guesser) == 429, "else there would be no bound on guesses"
    assert isinstance(log_in("correct horse battery", "192.168.1.7"), str)
    assert log_in("wrong", f"{network}:1") == 401
    assert log_in("correct horse battery", f"{network}:2%eth0") == 429
    assert isinstance(log_in("correct horse battery", "2001:db8:0:2::1"), str)
    assert log_in("wrong", "::ffff:10.0.0.1") == 401
    assert isinstance(log_in("correct horse battery", "::ffff:10.0.0.2"), str)
    now_s = 1.1
    assert isinstance(log_in("correct horse battery", guesser), str)
    statuses = [log_in("wrong", f"10.1.{number // 250}.{number % 250}") for number in range(1000)]
    assert statuses.count(401) == 256, "so many at most in a second, from however many addresses"
    now_s = 2.2
    assert isinstance(log_in("correct horse battery", "192.168.1.7"), str)


def test_beyond_this_machine_only_with_tls_a_password_and_a_name() -> None:
    for bind in ("127.0.0.1", "127.0.0.9", "::1", "localhost"):
        require_safe(Address(bind, 8470), password=False)
    outside = Address("192.168.1.5", 8470)
    for address, password in (
        (outside, False),
        (outside, True),
        (Address("192.168.1.5", 8470, secure=True), False),
        (Address("0.0.0.0", 8470, secure=True), True),
        (Address("::", 8470, secure=True), True),
        (Address("bench.example.org", 8470, secure=True), True),
    ):
        with pytest.raises(AccessError) as refused:
            require_safe(address, password=password)
        assert refused.value.cure
    require_safe(Address("192.168.1.5", 8470, secure=True), password=True)
    named = Address("0.0.0.0", 443, secure=True, names=("bench.example.org",))
    require_safe(named, password=True)
    assert named.url == "https://bench.example.org/"
    assert "bench.example.org:443" in named.hosts
    assert Address("::1", 8470).hosts == ("[::1]:8470", "localhost:8470")
    assert password_of("correct horse battery\n") == "correct horse battery"
    for text in ("short\n", "", "two lines of\nwhatever length\n"):
        with pytest.raises(AccessError):
            password_of(text)
