"""The files of a run as typed models: meta.json is a ``RunMeta``, result.json a ``RunResult``, a line of events.jsonl a
``RunEvent``. Each field says what its key means; docs/results.md is made from that.
"""

from rig.results.estimates import (
    BreakawayResult,
    BudgetEntry,
    EstimateResult,
    FoundLawResult,
    FrictionLawResult,
    HystereticResult,
    IdentificationResult,
    LawFit,
    LawNumberResult,
    PieceResult,
    RelayTestResult,
    ResidualResult,
    StaticFrictionResult,
    known,
)
from rig.results.event import DrivenModel, MeasuredDelay, RunEvent
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
    "BudgetEntry",
    "DeviceLoop",
    "DeviceSeen",
    "DrivenModel",
    "EstimateResult",
    "FaultReport",
    "FoundLawResult",
    "FrictionLawResult",
    "HystereticResult",
    "IdentificationResult",
    "JogResult",
    "JsonObject",
    "LawFit",
    "LawNumberResult",
    "LoopResult",
    "MeasuredDelay",
    "Part",
    "PieceResult",
    "Quantiles",
    "RealTimeReport",
    "RelayTestResult",
    "ResidualResult",
    "RunEvent",
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
