// Light or dark: as the system has it, until the reader chooses. Canvases ask here for the colours of panel.css.

import { byId, element } from "./dom.js";

const CHOICE = "rig-theme";
const system = matchMedia("(prefers-color-scheme: dark)");
const listeners = [];
const cache = new Map();
let probe = null;

/** The colour of a custom property of panel.css, as a canvas takes it. */
export function colour(name) {
  if (!cache.has(name)) {
    probe ??= document.body.appendChild(element("span", { hidden: true }));
    probe.style.color = `var(${name})`;
    cache.set(name, getComputedStyle(probe).color);
  }
  return cache.get(name);
}

/** Call this whenever the colours change. */
export const onTheme = (listener) => listeners.push(listener);

function changed() {
  cache.clear();
  const dark = isDark();
  byId("theme").setAttribute("aria-label", dark ? "Change to light" : "Change to dark");
  for (const listener of listeners) listener();
}

const isDark = () => (document.documentElement.dataset.theme ?? (system.matches ? "dark" : "light")) === "dark";

/** Take the reader's choice, and bring the button to life. */
export function startTheme() {
  const chosen = remembered();
  if (chosen) document.documentElement.dataset.theme = chosen;
  system.addEventListener("change", changed);
  byId("theme").addEventListener("click", () => {
    const next = isDark() ? "light" : "dark";
    document.documentElement.dataset.theme = next;
    try {
      localStorage.setItem(CHOICE, next);
    } catch {
      // without storage the choice holds for this page only
    }
    changed();
  });
  changed();
}

function remembered() {
  try {
    const chosen = localStorage.getItem(CHOICE);
    return chosen === "light" || chosen === "dark" ? chosen : null;
  } catch {
    return null;
  }
}
