// A click on Stop in a headless Chromium: when it was made, and when the page said that the drive is at 0 (ms since 1970).
//
//   node stop.mjs URL

import { createRequire } from "node:module";

const { chromium } = createRequire(new URL("../../tests/panel/browser/", import.meta.url))("playwright-core");
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--headless", "--no-sandbox", "--disable-gpu"] });
try {
  const page = await browser.newPage();
  await page.goto(process.argv[2]);
  await page.waitForFunction(() => document.getElementById("lamp").textContent === "Running");
  await page.evaluate(() => {
    const now = () => Date.now(); // the page's timeOrigin is old: the machine's clock may have been set meanwhile
    document.getElementById("stop").addEventListener("pointerdown", (event) => (globalThis.clicked = now() - (performance.now() - event.timeStamp)), { capture: true });
    const state = document.getElementById("stop-state");
    new MutationObserver(() => {
      if (state.textContent.includes("the drive is at 0")) globalThis.shown ??= now();
    }).observe(state, { childList: true, characterData: true, subtree: true });
  });
  await page.click("#stop");
  await page.waitForFunction(() => globalThis.shown);
  console.log(JSON.stringify(await page.evaluate(() => ({ click_ms: globalThis.clicked, shown_ms: globalThis.shown }))));
} finally {
  await browser.close();
}
