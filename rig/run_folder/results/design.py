"""What `rig design` says: the tests that would tell most about a motor, and how long they take."""

from __future__ import annotations

from pydantic import Field

from rig.run_folder.results.part import Count, Number, Part, Real, key

Row = tuple[Number, ...]


class DesignedGains(Part):
    """A pair of relay gains."""

    h1_V: Real = Field(description="gain of the relay on position, V")
    h2_V: Real = Field(description="gain of the relay on the integral, V")


class DesignedStroke(Part):
    """A stroke of a stroke test."""

    u_V: Real = Field(description="drive, V")
    turn_rad: Real = Field(description="position at which the next stroke begins, rad")


class DesignedSeconds(Part):
    """Seconds of test until the 95 % intervals of tau, K and f_c are so narrow; null: there is no such test."""

    interval_percent: Real = Field(description="half width of the intervals, % of the value")
    strokes_s: Number = key("of the strokes that are best for it, s")
    pair_s: Number = key("of the best two pairs of gains in turn, half of the time each, s")
    single_s: Number = key("of the best single pair of gains, s")


class DesignedMap(Part):
    """Relay tests over both gains."""

    h1_V: tuple[Real, ...] = Field(description="gains of the relay on position, V")
    h2_V: tuple[Real, ...] = Field(description="gains of the relay on the integral, V")
    seconds: tuple[Row, ...] = Field(
        description="a row for each h1: seconds until the wanted interval; null: the test never tells, or may stick, "
        "or may leave the room"
    )
    inside: Count = Field(description="how many pairs stay inside the room")


class DesignedMotion(Part):
    """The motion of the strokes, by the motor as it is believed."""

    t_s: tuple[Real, ...] = Field(description="times, s")
    y_rad: tuple[Real, ...] = Field(description="positions, rad")
    u_V: tuple[Real, ...] = Field(description="drives, V")


class BelievedMotor(Part):
    """The motor that the tests are designed for, and how it is read."""

    tau_s: Real = Field(description="time constant, s")
    K_rad_s_V: Real = Field(description="gain, (rad/s)/V")
    fc_V: Real = Field(description="friction, V")
    asym_V: Real = Field(description="asymmetry of the effective drive, V")
    static_V: Real = Field(description="level at which it breaks away, V")
    doubt_percent: Real = Field(description="tau, K and f_c may all be wrong by so many %")
    noise_rad: Real = Field(description="standard deviation of a reading, rad")
    delay_s: Real = Field(description="from a sample until its drive acts, s")


class DesignRoom(Part):
    """What a test may use."""

    low_rad: Real = Field(description="lowest position, rad")
    high_rad: Real = Field(description="highest position, rad")
    max_V: Real = Field(description="largest drive, V")
    max_speed_rad_s: Real = Field(description="largest speed, rad/s")
    horizon_s: Real = Field(description="time for which the guard looks ahead, s")


class DesignResult(Part):
    """The JSON of `rig design`."""

    motor: BelievedMotor
    room: DesignRoom
    wanted_percent: Real = Field(description="half width of the 95 % intervals that the map and the motion are for, %")
    strokes: tuple[DesignedStroke, ...] = key("the best strokes; empty: none may be used", ())
    gains: tuple[DesignedGains, ...] = key(
        "the best two pairs of gains, the harder first; one: only one may be used; empty: none", ()
    )
    single: DesignedGains | None = key("the best single pair of gains")
    until: tuple[DesignedSeconds, ...] = key("how long for what interval", ())
    map: DesignedMap
    motion: DesignedMotion | None = key("null: no strokes may be used")
