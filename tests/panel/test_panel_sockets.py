"""What a connection may cost."""

from __future__ import annotations

import socket
from contextlib import ExitStack

import pytest

from rig.panel.serve import listen
from rig.panel.sockets import MOST_AT_THE_DOOR, Meter


def test_the_door_lets_go_of_the_oldest_of_those_that_never_greet_and_of_nobody_inside() -> None:
    with ExitStack() as stack, listen("127.0.0.1", 0) as door:
        ours = {}

        def knock(address: str) -> socket.socket:
            caller = stack.enter_context(socket.create_connection(door.getsockname(), 5.0, (address, 0)))
            while caller.getsockname() not in ours:
                try:
                    connection, peer = door.accept()
                except BlockingIOError:  # now and then it says that there is none
                    continue
                ours[peer] = stack.enter_context(connection)
            caller.settimeout(0.02)
            return caller

        inside, other = knock("127.0.0.1"), knock("127.0.0.2")
        door.came_in(inside.getsockname())
        silent = [knock("127.0.0.1") for _ in range(MOST_AT_THE_DOOR + 9)]
        assert [one.recv(1) for one in silent[:10]] == [b""] * 10
        for one in (inside, other, silent[10], silent[-1]):
            with pytest.raises(TimeoutError):
                one.recv(1)


def test_a_meter_lets_pass_so_much_a_second() -> None:
    now_s = 0.0
    meter = Meter(10, lambda: now_s)
    assert [meter.take() for _ in range(11)] == [True] * 10 + [False]
    now_s = 0.55
    assert [meter.take() for _ in range(5)] == [True] * 4 + [False]
