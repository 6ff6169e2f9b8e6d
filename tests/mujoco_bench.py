"""A motor of MuJoCo's physics behind rig's interface for a device: none of its equations of motion are rig's.

A hinge with MuJoCo's ``armature``, ``damping`` and ``frictionloss`` turns a small mass on a lever, in gravity:

    (armature + m l^2) dv/dt + damping v + frictionloss sgn v + m g l sin(y - hanging) = gear u

Torques are in N m; divided by ``gear`` they are rig's volts.

MuJoCo's friction is a constraint that gives way a little. By MuJoCo's defaults it gives way a lot. Then 0.4 V make the
shaft creep at 16 mrad/s, although 0.48 V should hold it. After 5 s of +-1.2 V it is 30 mrad off a motor with Coulomb
friction. ``SOLREF`` and ``SOLIMP`` are as stiff as MuJoCo allows: at steps of 0.1 ms that is 0.2 mrad, and the shaft
creeps at 0.2 urad/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
from pydantic import Field

from rig.backends.backend import Backend, Unopened, Watchdog
from rig.backends.clock import VirtualClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.config.schema import DeviceSetup
from rig.core.section import Section
from rig.model.bench import BenchModel, BenchParameters
from rig.model.friction import coulomb
from rig.model.motor import Motor, State
from rig.model.real_motor import RealMotor

STEP_S = 1e-4
SOLREF = f"{2.0 * STEP_S} 1"  # the shortest time constant that a step bears, and critical damping
SOLIMP = "0.9999 0.9999 0.001 0.5 2"  # share of a constraint that is enforced, at rest and in motion: MuJoCo's largest
GRAVITY_M_S2 = 9.81
LATENCY_S = 0.0012
NOISE_RAD = 0.003
SMALLEST_KG_M2 = 1e-9  # MuJoCo wants an inertia of the mass about its own centre

MODEL = """
<mujoco>
  <compiler inertiafromgeom="false"/>
  <option timestep="{step_s}" integrator="implicitfast" gravity="0 0 -{gravity}" tolerance="1e-14"/>
  <worldbody>
    <body euler="0 {hanging_deg} 0">
      <joint name="shaft" type="hinge" axis="0 1 0" armature="{armature}" damping="{damping}"
             frictionloss="{frictionloss}" solreffriction="{solref}" solimpfriction="{solimp}"/>
      <inertial pos="0 0 -{lever}" mass="{mass}" diaginertia="{own} {own} {own}"/>
    </body>
  </worldbody>
  <actuator><motor joint="shaft" gear="{gear}"/></actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Shaft:
    """The numbers of the model.

    armature_kg_m2, damping_N_m_s, frictionloss_N_m   of the hinge
    gear_N_m_V     torque for one volt of drive
    mass_kg, lever_m, hanging_rad   the load, its distance from the axis, and the position in which it hangs
    """

    armature_kg_m2: float = 2e-4
    damping_N_m_s: float = 1.2e-3
    frictionloss_N_m: float = 3.7e-3
    gear_N_m_V: float = 7.7e-3
    mass_kg: float = 1e-6
    lever_m: float = 0.02
    hanging_rad: float = 0.7

    def model(self) -> Any:
        """The model, compiled by MuJoCo."""
        text = MODEL.format(
            step_s=STEP_S,
            gravity=GRAVITY_M_S2,
            hanging_deg=-math.degrees(self.hanging_rad),
            armature=self.armature_kg_m2,
            damping=self.damping_N_m_s,
            frictionloss=self.frictionloss_N_m,
            solref=SOLREF,
            solimp=SOLIMP,
            lever=self.lever_m,
            mass=self.mass_kg,
            own=SMALLEST_KG_M2,
            gear=self.gear_N_m_V,
        )
        return mujoco.MjModel.from_xml_string(text)

    @property
    def load_V(self) -> float:
        """What the load pulls when its lever is level, V."""
        return self.mass_kg * GRAVITY_M_S2 * self.lever_m / self.gear_N_m_V

    @property
    def motor(self) -> Motor:
        """Without the load's pull, in rig's numbers."""
        inertia = self.armature_kg_m2 + self.mass_kg * self.lever_m**2 + SMALLEST_KG_M2
        friction = coulomb(self.frictionloss_N_m / self.gear_N_m_V)
        return Motor(inertia / self.damping_N_m_s, self.gear_N_m_V / self.damping_N_m_s, friction)

    @property
    def real(self) -> RealMotor:
        """With the load's pull, about y = 0, in rig's numbers."""
        m = self.motor
        pull = {
            "force_sin_V": self.load_V * math.cos(self.hanging_rad),
            "force_cos_V": -self.load_V * math.sin(self.hanging_rad),
        }
        return RealMotor(m.tau_eff_s, m.K_eff_rad_s_V, m.friction.fc_V, **pull)


class MujocoBench(BenchModel):
    """The bench of rig's simulated driver, with MuJoCo's shaft in it."""

    def __init__(self, parameters: BenchParameters, shaft: Shaft, seed: int) -> None:
        super().__init__(parameters, seed)
        self._model = shaft.model()
        self._data = mujoco.MjData(self._model)
        self._steps, self._time_s = 0, 0.0

    def advance(self, dt_s: float) -> None:
        """Let ``dt_s`` pass, to the nearest step of MuJoCo."""
        self._time_s += dt_s
        steps = round(self._time_s / STEP_S) - self._steps
        self._data.ctrl[0] = self.motor_V
        if steps > 0:
            mujoco.mj_step(self._model, self._data, steps)
        self._steps += steps
        self.state = State(float(self._data.qvel[0]), float(self._data.qpos[0]), 0.0)
        if self.armed_for_s >= 0.0:
            self.armed_for_s += dt_s


class ShaftOptions(Section):
    """What stands under ``daq.options``."""

    mass_kg: float = Field(1e-6, gt=0.0, description="mass of the load on the lever")


class MujocoBackend(Backend):
    """``driver: mujoco``: a shaft of MuJoCo's, in virtual time."""

    name = "mujoco"
    section = ShaftOptions
    shared_keys = frozenset({"options"})

    def watchdog(self, d: DeviceSetup) -> Watchdog:
        return Watchdog(d.daq.watchdog_s)

    def writes_first(self, d: DeviceSetup) -> bool:
        return False

    def words(self, d: DeviceSetup) -> str:
        return "a shaft of MuJoCo's in virtual time, nothing moves"

    def is_emulated(self, d: DeviceSetup) -> bool:
        return True

    @contextmanager
    def unopened(self, d: DeviceSetup) -> Iterator[Unopened]:
        shaft, clock = self.shaft(d), VirtualClock()
        truth = BenchParameters(shaft.motor, noise_rad=NOISE_RAD, real=shaft.real)
        driver = SimulatedDriver(clock, truth, d.scaling, SimulatedLatency(LATENCY_S, 0.0), d.seed)
        driver.bench = MujocoBench(truth, shaft, d.seed)
        driver.backend = f"MuJoCo {mujoco.__version__} in virtual time"
        yield Unopened(driver, clock, truth)

    def shaft(self, d: DeviceSetup) -> Shaft:
        """The shaft of the config."""
        return Shaft(mass_kg=self.options(d, ShaftOptions).mass_kg)


MUJOCO = MujocoBackend()
