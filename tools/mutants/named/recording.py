"""Defects of the recorder, of its writer and of the reader."""

from __future__ import annotations

from mutants.named.writing import in_file, of


def _recorder(*names: str) -> tuple[str, ...]:
    return in_file("tests/recording/test_recording_recorder.py", *names)


def _disk(*names: str) -> tuple[str, ...]:
    return in_file("tests/recording/test_recording_failing_disk.py", *names)


def _reader(*names: str) -> tuple[str, ...]:
    return in_file("tests/recording/test_recording_reader.py", *names)


WRITER = of(
    "rig/recording/writer.py",
    (
        "the last rows are dropped",
        "Writer.serve",
        "        self._write_rows(counters[layout.ROWS_OPENED])\n",
        "",
        _recorder("test_after_kill_9_every_opened_row_is_in_the_file"),
    ),
    (
        "the row that is open at the end is dropped",
        "Writer.serve",
        "        self._write_rows(counters[layout.ROWS_OPENED])\n",
        "        self._write_rows(counters[layout.ROW_COMPLETED])\n",
        _recorder("test_the_open_row_keeps_the_commanded_drive"),
    ),
    (
        "the last events are dropped",
        "Writer.serve",
        "        self._write_events(counters[layout.EVENT_BYTES])\n        self._write_last_words()",
        "        self._write_last_words()",
        _recorder("test_events_keep_their_order_and_types"),
    ),
    (
        "a row is written before it is complete",
        "Writer.serve",
        "self._write_rows(opened if completed == opened else opened - 1)",
        "self._write_rows(opened)",
        _recorder("test_an_open_row_waits_for_its_completion"),
    ),
    (
        "the room that was kept is not given up",
        "Writer._makes_room",
        "        room.give_up()\n",
        "",
        _recorder("test_what_comes_until_the_loop_has_ended_fits_on_a_full_disk"),
    ),
    (
        "no room is kept",
        "Writer.keep_room",
        "self._room = KeptRoom(self._folder, KEPT_BYTES)",
        "pass",
        _recorder("test_what_comes_until_the_loop_has_ended_fits_on_a_full_disk"),
    ),
    (
        "a full disk is not told",
        "Writer._makes_room",
        "        self._shared.fail(layout.CANNOT_WRITE, _in_words(error))\n",
        "",
        _recorder("test_what_comes_until_the_loop_has_ended_fits_on_a_full_disk"),
    ),
    (
        "a record that goes on elsewhere is not told",
        "Writer._moved",
        "        self._shared.fail(layout.MOVED, places)\n",
        "",
        _disk("test_a_write_error_costs_no_row_and_no_event"),
    ),
    (
        "what the disk may not have is not written again",
        "AppendOnlyFile._go_on_elsewhere",
        "rest = memoryview(bytes(self._since))",
        'rest = memoryview(b"")',
        _disk("test_rows_that_the_kernel_could_not_put_on_the_disk_are_written_again"),
    ),
    (
        "nothing is put on the disk before the end",
        "Writer.serve",
        "                self._sync()\n",
        "",
        _disk("test_rows_are_put_on_the_disk_every_second"),
    ),
    (
        "a torn line is left in the file",
        "AppendOnlyFile.whole_lines",
        "            os.ftruncate(self._descriptor, end)\n",
        "            pass\n",
        _recorder("test_a_killed_writer_is_reported_and_its_rows_are_rescued"),
    ),
    (
        "a writer that lost rows does not say so",
        "Writer._write_last_words",
        "if lost_rows or lost_events:",
        "if False:",
        _recorder("test_rows_and_events_that_find_no_room_are_counted_and_never_overwrite"),
    ),
    (
        "the writer waits for the loop for ever",
        "Writer.serve",
        "over = is_over.wait(POLL_S) or os.getppid() != parent",
        "over = is_over.wait(POLL_S) and False",
        _recorder("test_after_kill_9_every_opened_row_is_in_the_file"),
    ),
    (
        "Ctrl-C ends the writer",
        "main",
        "            signal.signal(getattr(signal, name), signal.SIG_IGN)\n",
        "            pass\n",
        _recorder("test_signals_to_the_writer_do_not_end_it"),
    ),
)

RECORDER = of(
    "rig/recording/recorder.py",
    (
        "rows that wait are overwritten",
        "Recorder.sample",
        "if opened - self._counters[layout.ROWS_TAKEN] >= self._capacity_rows:",
        "if False:",
        _recorder("test_rows_and_events_that_find_no_room_are_counted_and_never_overwrite"),
    ),
    (
        "events that wait are overwritten",
        "Recorder.event",
        "if written + len(line) - self._counters[layout.EVENT_BYTES_TAKEN] > size:",
        "if False:",
        _recorder("test_rows_and_events_that_find_no_room_are_counted_and_never_overwrite"),
    ),
    (
        "a writer that has ended goes unnoticed",
        "Recorder.check",
        "reason = self._ended() or self._lost()",
        "reason = self._lost()",
        _recorder("test_a_killed_writer_is_reported_and_its_rows_are_rescued"),
    ),
    (
        "lost rows go unnoticed",
        "Recorder.check",
        " or self._lost()",
        "",
        _recorder("test_rows_and_events_that_find_no_room_are_counted_and_never_overwrite"),
    ),
    (
        "a memory that fills up goes unnoticed",
        "Recorder.check",
        " or self._far_behind()",
        "",
        _recorder("test_the_memory_filling_up_is_reported_before_a_row_is_lost"),
    ),
    (
        "a writer that stands still goes unnoticed",
        "Recorder.check",
        " or self._stalled()",
        "",
        _recorder("test_a_stopped_writer_is_reported_long_before_the_memory_is_full_and_no_row_is_lost"),
    ),
    (
        "rows of a killed writer are lost",
        "Recorder.close",
        "if self._process.returncode < 0 and not self._moved():",
        "if False:",
        _recorder("test_a_killed_writer_is_reported_and_its_rows_are_rescued"),
    ),
    (
        "a second writer hides what the first one lost",
        "Recorder.close",
        "if self._process.returncode < 0 and not self._moved():",
        "if self._process.returncode < 0:",
        _disk("test_a_writer_that_is_killed_after_the_disk_failed_is_not_followed_by_one_that_hides_the_loss"),
    ),
    (
        "closing says nothing of what was lost",
        "Recorder.close",
        "reason = self._unwritten() or self._lost() or self._moved()",
        'reason = ""',
        _disk("test_the_run_ends_and_says_where_the_rest_is"),
    ),
    (
        "a stopped writer is not told to go on",
        "Recorder.close",
        "            self._process.send_signal(signal.SIGCONT)\n",
        "",
        _recorder("test_closing_lets_a_stopped_writer_go_on"),
    ),
)

READER = of(
    "rig/recording/recording.py",
    (
        "time that goes back is accepted",
        "_check_time",
        "    if len(bad):\n",
        "    if False:\n",
        _reader("test_a_broken_file_is_an_error_with_line_and_cure"),
    ),
)

FILES = of(
    "rig/recording/text_file.py",
    (
        "a torn last line is read",
        "without_torn_line",
        'end = written.rfind(b"\\n") + 1',
        "end = len(written)",
        _reader("test_a_torn_last_line_is_left_out_and_noted_wherever_it_tears"),
    ),
    (
        "what the recorder wrote beside the file is not read",
        "whole_content",
        "        content = content[:number] + content_of(part)\n",
        "",
        _disk("test_a_write_error_costs_no_row_and_no_event"),
    ),
)

MUTANTS = (*WRITER, *RECORDER, *READER, *FILES)
