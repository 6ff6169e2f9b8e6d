"""What a run says of itself, typed: meta.json (``RunMeta``), result.json (``RunResult``), and what is in them."""

from rig.results.estimates import (
    BreakawayResult,
    EstimateResult,
    FrictionLawResult,
    HystereticResult,
    IdentificationResult,
    LawFit,
    RelayTestResult,
    ResidualResult,
    StaticFrictionResult,
    known,
)
from rig.results.meta import DeviceSeen, RealTimeReport, RunMeta, ScriptCall, SupplyBelieved, TrueMotor
from rig.results.part import JsonObject, Part
from rig.results.result import (
    DeviceLoop,
    FaultReport,
    JogResult,
    LoopResult,
    Quantiles,
    RunResult,
    SearchStepResult,
    TrackingResult,
)

__all__ = [
    "BreakawayResult",
    "DeviceLoop",
    "DeviceSeen",
    "EstimateResult",
    "FaultReport",
    "FrictionLawResult",
    "HystereticResult",
    "IdentificationResult",
    "JogResult",
    "JsonObject",
    "LawFit",
    "LoopResult",
    "Part",
    "Quantiles",
    "RealTimeReport",
    "RelayTestResult",
    "ResidualResult",
    "RunMeta",
    "RunResult",
    "ScriptCall",
    "SearchStepResult",
    "StaticFrictionResult",
    "SupplyBelieved",
    "TrackingResult",
    "TrueMotor",
    "known",
]
