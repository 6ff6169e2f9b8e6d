"""Errors on the link, told while the run goes on."""

from __future__ import annotations

from simulated_bench import LIMITS, simulated_bench

from rig.control.law import Rest


def test_an_event_tells_of_each_new_error_and_of_no_exchange() -> None:
    bench = simulated_bench()
    counts: dict[str, int] = {"exchanges": 7, "timeouts": 0, "bad_frames": 0}
    bench.driver.link_statistics = counts

    def watch(t_s: float) -> None:
        counts["exchanges"] += 1
        if counts["exchanges"] == 37:
            counts.update(timeouts=1, bad_frames=2)

    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(1.5), "rest", watch)
    told = [event for event in bench.record.events if event["kind"] == "link"]
    assert [(event["errors"], event["most"]) for event in told] == [(3, "bad_frames")]
