"""The host's side of the process that stops a servo when this one dies or hangs (``rig.running.keeper.silence``)."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from rig.backends.servo.before import BeforeStore, Sets, back_of, text_of
from rig.backends.servo.bus import Ask, ServoLink
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault
from rig.core.first_process import first_that_ends_with
from rig.core.halted import Halts
from rig.core.heartbeat import SIZE, Heartbeat
from rig.core.memory_file import create_file

_STARTS_S: Final = 10.0
_ENDS_S: Final = 3.0
_READY: Final = b"ready\n"
# begins with the first line of its standard input: it loads nothing but rig and the standard library
_BEGINS: Final = "import sys; exec(sys.stdin.buffer.readline())"
_FIRST_LINE: Final = "sys.path.append({!r}); from rig.running.keeper.silence import main; sys.exit(main(sys.argv[1:]))"
_PACKAGES: Final = str(Path(__file__).resolve().parents[3])
_LOOK, _DONE = b"l", b"d"  # as in ``rig.running.keeper.silence``

_left_running: list[subprocess.Popen[bytes]] = []  # each for half a minute at most


class ServoKeeper:
    """The process, and what it is told.

    link        of the servo
    store       holds the values to put back
    descriptor  of the open port
    silence_s   after which it stops the servo
    Raises Fault SERVO_UNWATCHED where it does not start.
    """

    def __init__(self, link: ServoLink, store: BeforeStore, descriptor: int, silence_s: float) -> None:
        self._drives = False
        files = {
            "before": "" if store.path is None else str(store.path),
            "note": "" if store.note_path is None else str(store.note_path),
        }
        orders = {**self.orders(link, store), **files, "silence_s": silence_s}
        try:
            memory = create_file(SIZE)
            try:
                heard, self._pipe = os.pipe()
            except OSError:
                os.close(memory)
                raise
        except OSError as error:
            raise Fault("SERVO_UNWATCHED", error.strerror or str(error)) from error
        os.set_blocking(self._pipe, False)
        keep_from_copies(self._pipe)
        descriptors = (descriptor, heard, memory)
        try:
            self._heart = Heartbeat(memory)
            self.waits = self._heart.waits
            self._process = subprocess.Popen(
                # no word of it is rig, whatever folder rig is in: `pkill -9 -f rig` must not end both
                [str(Path(sys.executable).resolve()), "-I", "-S", "-c", _BEGINS, *map(str, descriptors)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                pass_fds=descriptors,
                start_new_session=True,  # Ctrl-C in the terminal is not meant for it
            )
        except OSError as error:
            self._let_go()
            raise Fault("SERVO_UNWATCHED", error.strerror or str(error)) from error
        finally:
            os.close(heard)
            os.close(memory)
        self._halts = Halts(self._process)
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            words = f"{_FIRST_LINE.format(_PACKAGES)}\n{json.dumps(orders)}\n"
            self._process.stdin.write(words.encode("utf-8"))
            is_ready = select.select([self._process.stdout], [], [], _STARTS_S)[0]
            if not is_ready or self._process.stdout.read(len(_READY)) != _READY:
                raise Fault("SERVO_UNWATCHED", "it was not ready in time")
        except BaseException as error:  # Ctrl-C, too
            self._process.kill()  # one that comes late would write to a servo that is another program's by then
            self._process.wait()
            self._let_go()
            self._close()
            if not isinstance(error, OSError | Fault):
                raise
            raise Fault("SERVO_UNWATCHED", error.detail if isinstance(error, Fault) else str(error)) from error

    @staticmethod
    def orders(link: ServoLink, store: BeforeStore) -> dict[str, Any]:
        """What it writes to stop the servo, and to put it back, and what confirms each, in hexadecimal digits.

        And what it writes to the file of before meanwhile, ahead of which order.
        """
        values, sets = store.read(link.model)
        restoring, mark = _restoring(link, values or {}, sets)
        return {
            "stop": _orders(link, stop_orders(link)),
            "restore": restoring,
            "mark": mark,
            "zero": _zero(link),
        }

    @property
    def has_acted(self) -> bool:
        """Whether it stops the servo, or has stopped it, because this process was silent."""
        return self._heart.was_silent

    def beat(self) -> None:
        """The process lives, and may drive. Raises Fault SERVO_UNWATCHED where nobody hears it."""
        if self._halts.event() is not None and (words := self._halts.words):
            raise Fault("SERVO_UNWATCHED", words)
        self._heart.beat()
        if not self._drives:  # it sleeps until it is told
            self._tell(_LOOK)
            self._drives = True

    def rest(self) -> None:
        """Nothing drives. What it did before is over."""
        self._heart.rest()
        self._drives = False

    def end(self, *, restored: bool) -> None:
        """It is needed no more; where the registers were not put back it stops the servo and does that first.

        Where nobody answers it goes on after this returns, as after the death of this process: a plug may come back.
        """
        if restored:
            self._tell(_DONE)
        self._let_go()
        if self._process.poll() is None and self._halts.is_stopped:
            self._process.kill()
        try:
            self._process.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            if restored:
                self._process.kill()
                self._process.wait()
            else:
                _left_running.append(self._process)
        self._close()

    def _close(self) -> None:
        self._heart.close()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def _tell(self, word: bytes) -> None:
        """Wake it up with a word. One that has ended hears none: the next beat says so."""
        with contextlib.suppress(OSError):
            os.write(self._pipe, word)

    def _let_go(self) -> None:
        no_longer_own(self._pipe)
        with contextlib.suppress(OSError):
            os.close(self._pipe)


def starter(
    descriptor: int, silence_s: float, *, moves: bool = True
) -> Callable[[ServoLink, BeforeStore], ServoKeeper]:
    """What starts the keeper of a servo on an open port; ``moves``: it is a real one.

    Raises Fault SERVO_UNWATCHED where the keeper of a real one would end with this process.
    """

    def start(link: ServoLink, store: BeforeStore) -> ServoKeeper:
        if moves and (first := first_that_ends_with(os.getpid())):
            raise Fault(
                "SERVO_UNWATCHED",
                f"this container lives for `{first}`, which ends with rig: so would rig's keeper. Start the container "
                "with what lives on, such as a shell (`docker run -it IMAGE bash`), and start rig in it",
            )
        return ServoKeeper(link, store, descriptor, silence_s)

    return start


def stop_orders(link: ServoLink) -> list[Ask]:
    """Duty 0, then torque off: where a watchdog that has acted takes no duty, the second does it.

    One with a lock may have lost its mode with its supply: in another one the write of a duty may switch its torque on.
    """
    roles = link.model.roles
    off = link.write_of(roles["torque"], 0)
    return [off] if "lock" in roles else [link.write_of(roles["drive"], 0), off]


def _zero(link: ServoLink) -> list[tuple[str, str]]:
    """Of one with a lock, once its torque is off: a look whether it is in PWM mode still, and behind that duty 0.

    Else rig's duty would stay, for whoever puts it into that mode next. It may switch the torque on: off follows.
    """
    roles, codec = link.model.roles, link.bus.codec
    if "lock" not in roles:
        return []  # it got duty 0 with the stop
    mode = link.model.role("mode")
    look = link.bus.reading(mode.address, mode.size, mode.name).data
    is_there = codec.status(link.bus.id, mode.pack(link.model.pwm_mode))
    return [(look.hex(), is_there.hex()), *_orders(link, [link.write_of(roles["drive"], 0)])]


def _restoring(link: ServoLink, values: Mapping[str, int], sets: Sets) -> tuple[list[tuple[str, str]], tuple[int, str]]:
    """What puts registers back, as ``put_back`` does, and what the file must say, ahead of which of it; -1: nothing.

    All but the limit, and the goal behind it, is looked at ahead of these: a late answer may have confirmed a write
    that was lost.
    """
    roles, back = link.model.roles, back_of(link.model, values, sets, is_blind=True)
    off, watchdog = (roles["torque"], 0), [(roles[role], 0) for role in ("watchdog",) if role in roles]
    early = [(name, value) for name, value in back.early if name in sets]  # EEPROM, which no mode resets
    begins = [off, *([off] if "lock" in roles else watchdog), *early]  # ``_zero`` comes in between
    steps = [*_writes(link, [*begins, *back.middle, off]), *_looks(link, [*watchdog, *early, *back.middle])]
    steps += [*_writes(link, back.last), *_looks(link, back.last), *_writes(link, [off])]
    if back.told is None:
        return steps, (-1, "")
    return steps, (len(begins), text_of(link.model, link.bus.id, values, back.told))


def _writes(link: ServoLink, steps: list[tuple[str, int]]) -> list[tuple[str, str]]:
    return _orders(link, [link.write_of(name, value) for name, value in steps])


def _looks(link: ServoLink, steps: list[tuple[str, int]]) -> list[tuple[str, str]]:
    """Whether each register holds what was written there last."""
    looks = []
    for name, value in dict(steps).items():
        register = link.model[name]
        answer = link.bus.codec.status(link.bus.id, register.pack(value))
        looks.append((link.bus.reading(register.address, register.size, name).data.hex(), answer.hex()))
    return looks


def _orders(link: ServoLink, asks: list[Ask]) -> list[tuple[str, str]]:
    """In hexadecimal digits, with the answer that confirms each."""
    answer = link.bus.confirmed().hex()
    return [(ask.data.hex(), answer) for ask in asks]
