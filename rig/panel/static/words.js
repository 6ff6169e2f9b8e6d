// Numbers as people read them. Widths stay the same while a number changes: fixed decimals, and a true minus sign.

const NONE = "–";

/** A number with fixed decimals; a dash where there is none. */
export function fixed(value, decimals, { signed = false } = {}) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  const size = Math.abs(value).toFixed(decimals);
  const sign = value < 0 && Number(size) !== 0 ? "−" : signed ? "+" : "";
  return sign + size;
}

/** A whole number; a dash where there is none. */
export const whole = (value) => fixed(value, 0);

/** Decimals so that the half width of an interval has two figures. */
export function decimalsFor(half) {
  if (!(half > 0)) return 4;
  return Math.min(6, Math.max(0, 1 - Math.floor(Math.log10(half))));
}

/** A value with half its interval, for people: 0.1699 ±0.0006. */
export function withInterval(pair) {
  if (!pair || !Number.isFinite(pair[0])) return NONE;
  const [value, half] = pair;
  if (!Number.isFinite(half)) return fixed(value, 4);
  const decimals = decimalsFor(half);
  return `${fixed(value, decimals)} ±${fixed(half, decimals)}`;
}

/** Half an interval in per cent of its value; beyond the value itself it is unknown. */
export function percent([value, half]) {
  const share = Math.abs(half / value) * 100;
  if (share > 100) return "unknown";
  return Number.isFinite(share) ? `±${share < 10 ? share.toFixed(2) : share.toFixed(0)} %` : NONE;
}

const OLD_MS = 1000; // rows older than this are not live: the run computes, or it hangs
const COMPUTES = "identify"; // the stage in which nothing drives

/** The run is over, and its process is not: it writes the result and draws the report. */
export const DRAWS = "The run is over: rig draws the report.";

/** Why the newest reading of a live message is old; empty while it is not. */
export function whyOld({ age_ms, is_over, stage }) {
  if (!(age_ms > OLD_MS)) return "";
  if (is_over) return DRAWS;
  const silent = `no reading for ${fixed(age_ms / 1000, 0)} s`;
  return stage === COMPUTES ? `The run computes: ${silent}.` : `The run is silent: ${silent}.`;
}

/** When a run began, in the reader's own time. */
export function moment(iso) {
  const when = new Date(iso);
  if (!iso || Number.isNaN(when.getTime())) return NONE;
  return when.toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

/** Name, symbol and unit of each estimated parameter. */
export const PARAMETERS = [
  { key: "tau_s", symbol: "τ", name: "time constant", unit: "s" },
  { key: "K_rad_s_V", symbol: "K", name: "speed per volt", unit: "(rad/s)/V" },
  { key: "fc_V", symbol: "f_c", name: "friction", unit: "V" },
];
