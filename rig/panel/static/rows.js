// The newest rows of the run, for the curves: what came in, in order, as far back as a curve shows.

const KEEP_S = 40;
const KEEP_ROWS = 24000;
const NAMES = ["t_s", "y_rad", "u_V", "z_rad_s"];

export class Rows {
  constructor() {
    this.clear();
  }

  /** Forget all rows: another run begins. */
  clear() {
    for (const name of NAMES) this[name] = [];
  }

  /** Time of the newest row, s; null while there is none. */
  get last_s() {
    return this.t_s.at(-1) ?? null;
  }

  /** Add the rows of one message. Those that are here already are left out. */
  add(rows) {
    const times = rows?.t_s ?? [];
    const last = this.last_s ?? -Infinity;
    let first = 0;
    while (first < times.length && times[first] <= last) first++;
    for (let k = first; k < times.length; k++) {
      for (const name of NAMES) this[name].push(rows[name]?.[k] ?? null);
    }
    this.#drop();
  }

  #drop() {
    const oldest = (this.last_s ?? 0) - KEEP_S;
    // in large steps: dropping the first rows of an array at each message would copy it at each message
    let old = 0;
    while (old < this.t_s.length && (this.t_s[old] < oldest || this.t_s.length - old > KEEP_ROWS)) old++;
    if (old > 1000) for (const name of NAMES) this[name].splice(0, old);
  }
}

/** Index of the first time at or after t. */
export function firstFrom(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < t) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The smallest of 1, 2, 5, 10... (times a power of ten) that is at least this size. */
export function roundUp(size) {
  if (!(size > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(size));
  return [1, 2, 5, 10].find((step) => step * power >= size * (1 - 1e-9)) * power;
}
