"use strict";

// The exact motor between two changes of its drive, as rig/model/motor.py has it:
//     tau dv/dt + v = K (u + b - f(v)),   dy/dt = v
// Coulomb and static friction; no Stribeck effect, no viscous friction, no mechanical stops.
class Motor {
  constructor(parameters) {
    Object.assign(this, parameters); // tau_s, K_rad_s_V, fc_plus_V, fc_minus_V, fs_plus_V, fs_minus_V, bias_V
    this.v_rad_per_s = 0;
    this.y_rad = parameters.start_rad;
  }

  // Velocity that the motion tends to until it next reverses, rad/s.
  #target(u_V) {
    const drive_V = u_V + this.bias_V;
    const v = this.v_rad_per_s;
    if (v > 0 || (v === 0 && drive_V > this.fs_plus_V)) return this.K_rad_s_V * (drive_V - this.fc_plus_V);
    if (v < 0 || drive_V < -this.fs_minus_V) return this.K_rad_s_V * (drive_V + this.fc_minus_V);
    return 0; // friction holds it
  }

  #glide(target, h_s) {
    const decay = -Math.expm1(-h_s / this.tau_s);
    const excess = this.v_rad_per_s - target;
    this.v_rad_per_s -= excess * decay;
    this.y_rad += target * h_s + excess * this.tau_s * decay;
  }

  advance(u_V, dt_s) {
    const v = this.v_rad_per_s;
    const target = this.#target(u_V);
    const stop_s = v * target < 0 ? this.tau_s * Math.log1p(-v / target) : Infinity;
    if (stop_s >= dt_s) {
      this.#glide(target, dt_s);
      return;
    }
    this.#glide(target, stop_s);
    this.v_rad_per_s = 0;
    this.#glide(this.#target(u_V), dt_s - stop_s);
  }
}

module.exports = { Motor };
