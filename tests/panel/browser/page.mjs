// A user before the panel: opens it, checks, starts, stops, reads the report, lays runs over each other, jogs, and
// loses the connection in each way there is. It prints what the page showed, as one JSON object; the test judges it.
//
//   node page.mjs '{"url", "panel_pid", "runs", "config", "calibrate_config", "jog_config", "shared_url", "password", "shots", "patience_ms"}'
//
// config: the file that the panel starts; calibrate_config, jog_config: what it becomes before the calibration and the
// jogs; shared_url, password: of a panel that gives several browsers a session; shots: folder for pictures or null;
// patience_ms: longer than any machine holds a process up

import { copyFileSync, existsSync, readFileSync, readdirSync } from "node:fs";
import { chromium } from "playwright-core";

const { url, panel_pid, runs, config, calibrate_config, jog_config, shared_url, password, shots, patience_ms } = JSON.parse(process.argv[2]);
const FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync", "--renderer-process-limit=1", "--disable-features=SpareRendererForSitePerProcess,IsolateSandboxedIframes"];
const seen = { complaints: [], stops: 0, unnamed: [], heard: {} };
let page;

/** Wait until this is true of the page; fails with its name. */
async function until(name, true_, ...given) {
  await page.waitForFunction(true_, given, { timeout: patience_ms, polling: 100 }).catch(() => {
    throw new Error(`it never happened: ${name}`);
  });
}
const text = (id) => page.locator(`#${id}`).textContent();
const says = (id, words) => until(`${id} says ${words}`, ([id, words]) => document.getElementById(id).textContent.includes(words), id, words);
const picture = async (name) => shots && page.screenshot({ path: `${shots}/${name}.png` });

async function open(context, address) {
  const opened = await context.newPage();
  opened.setDefaultTimeout(patience_ms);
  opened.on("pageerror", (error) => seen.complaints.push(String(error)));
  opened.on("console", (message) => message.type() === "error" && seen.complaints.push(message.text()));
  opened.on("request", (request) => (seen.stops += request.url().endsWith("/api/stop") ? 1 : 0));
  // the wire between page and server, to be cut
  await opened.routeWebSocket(/\/ws$/, (socket) => {
    const server = socket.connectToServer();
    socket.onMessage((message) => opened.cut || server.send(message));
    server.onMessage((message) => opened.cut || socket.send(message));
  });
  await opened.goto(address);
  return opened;
}

/** The newest jog on the disk, where the panel may be dead: its drives, V, and whether it is over. */
function jog() {
  const folder = `${runs}/${readdirSync(runs).filter((name) => name.includes("-jog")).sort().at(-1)}`;
  if (!existsSync(`${folder}/samples.csv`)) return { drives: [], over: false };
  const [head, ...lines] = readFileSync(`${folder}/samples.csv`, "utf8").split("\n").slice(0, -1);
  const column = head.split(",").indexOf("u_V");
  const drives = lines.map((line) => Number(line.split(",")[column])).filter(Number.isFinite);
  return { drives, over: readFileSync(`${folder}/events.jsonl`, "utf8").includes('"end"') };
}

/** Tab to the control whose words begin so, and press Enter. */
async function choose(words) {
  for (let tabs = 0; tabs < 60; tabs++) {
    await page.keyboard.press("Tab");
    if ((await page.evaluate(() => document.activeElement.textContent)).startsWith(words)) return page.keyboard.press("Enter");
  }
  throw new Error(`no Tab leads to ${words}`);
}

/** What a screen reader would find without a name, and the names of the buttons that it finds. */
async function hear(view) {
  const reader = await page.context().newCDPSession(page);
  const { nodes } = await reader.send("Accessibility.getFullAXTree");
  await reader.detach();
  const parts = nodes.filter((node) => !node.ignored).map((node) => ({ role: node.role?.value, name: node.name?.value?.trim() ?? "" }));
  const named = ["button", "link", "checkbox", "textbox", "searchbox", "slider", "image", "img", "canvas", "dialog", "region", "form", "group", "log", "table", "Iframe"];
  seen.unnamed.push(...parts.filter(({ role, name }) => named.includes(role) && name === "").map(({ role }) => `${view}: ${role}`));
  seen.heard[view] = parts.filter(({ name }) => name).map(({ role, name }) => `${role} ${name}`);
}

const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

async function eventually(name, true_) {
  const until_ms = performance.now() + patience_ms;
  while (!true_()) {
    if (performance.now() > until_ms) throw new Error(`it never happened: ${name}`);
    await sleep(50);
  }
}

/** Hold the jog's button until the shaft is driven. An emulated board on a busy machine may end a jog: begin again. */
async function holdJog() {
  for (let tries = 0; tries < 5; tries++) {
    await until("a jog can begin, or be held", () => !document.getElementById("jog").disabled);
    if (await page.isDisabled("#jog-plus")) {
      await page.click("#jog-ready");
      await until("the jog begins", () => document.getElementById("lamp").textContent !== "Idle");
    }
    await until("the jog can be held, or is over", () => !document.getElementById("jog-plus").disabled || document.getElementById("lamp").textContent === "Idle");
    if (!(await page.isEnabled("#jog-plus"))) continue;
    await page.locator("#jog-plus").scrollIntoViewIfNeeded();
    const box = await page.locator("#jog-plus").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    while (!jog().over && (await page.locator(".held").count()) === 1) {
      if (jog().drives.at(-1) > 0) return;
      await sleep(50);
    }
    await page.mouse.up();
    if (jog().over) await until("the page knows that the jog is over", () => document.getElementById("lamp").textContent !== "Jogging");
  }
  throw new Error("no jog lasted until it drove");
}

/** Jog, lose the bench in this way, and count the driven ticks from then until the shaft rests. */
async function jogUntil(lost) {
  await holdJog();
  const before = jog().drives.length;
  await lost();
  await eventually("the jog rests", () => jog().over || (jog().drives.length > before + 10 && jog().drives.slice(-10).every((u) => u === 0)));
  return { driven_ticks: jog().drives.slice(before).filter((u) => u !== 0).length };
}

const steps = {
  async opens_and_checks() {
    page = await open(seen.context, url);
    await says("lamp", "Idle");
    await hear("bench");
    await choose("Check and start");
    await until("the sheet", () => !document.getElementById("sheet").hidden);
    seen.sheet = {
      address: page.url(),
      plan: await text("plan"),
      lines: await page.locator("#check-lines li").count(),
      on_top_at_stop: await page.evaluate(() => {
        const box = document.getElementById("stop").getBoundingClientRect();
        return document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2).closest("button")?.id;
      }),
    };
    await hear("sheet");
    await picture("sheet");
  },

  async starts_and_shows_the_run() {
    const curve = () => page.evaluate(() => document.querySelector("#plot-y canvas").toDataURL());
    await page.evaluate(() => {
      globalThis.shifted = [];
      new PerformanceObserver((list) => list.getEntries().filter((entry) => !entry.hadRecentInput).forEach((entry) => globalThis.shifted.push(...entry.sources.map(({ node }) => node?.id || node?.className || node?.nodeName)))).observe({ type: "layout-shift" });
    });
    await choose("Start: the motor will move");
    await until("rows", () => document.getElementById("y").textContent !== "–");
    const first = await curve();
    await until("an estimate", () => document.querySelector("#estimate-tau_s .estimate-value").textContent.includes("±"));
    seen.live = {
      moved: first !== (await curve()),
      estimate: await text("parameters"),
      shifted: await page.evaluate(() => globalThis.shifted),
      live_regions: await page.evaluate(() => ["y", "u", "stage", "faults", "silence"].map((id) => document.getElementById(id).closest("[aria-live], [role=alert]")?.id ?? null)),
    };
    await picture("live");
  },

  async is_watched_without_a_token_and_without_uplot() {
    const context = await browser.newContext({ viewport: { width: 360, height: 740 }, colorScheme: "dark" });
    const watcher = await context.newPage();
    await watcher.route("**/uPlot.esm.js", (route) => route.abort());
    await watcher.goto(new URL("/", url).href);
    await watcher.waitForFunction(() => document.getElementById("y").textContent !== "–" && !document.getElementById("no-uplot").hidden);
    seen.watcher = {
      note: await watcher.locator("#watcher").textContent(),
      start: await watcher.isEnabled("#start"),
      stop: await watcher.isEnabled("#stop"),
      too_wide_px: await watcher.evaluate(() => document.documentElement.scrollWidth - innerWidth),
    };
    if (shots) await watcher.screenshot({ path: `${shots}/watcher.png` });
    await context.close();
  },

  async stops_by_a_key() {
    await page.focus("#zoom");
    await page.keyboard.press("Space");
    await says("stop-state", "the drive is at 0");
    await says("faults", "INTERRUPTED");
    seen.stopped = { stops: seen.stops, zoomed: await page.getAttribute("#zoom", "aria-pressed"), fault: await text("faults"), state: await text("stop-state") };
    await says("stage", "ended");
    await picture("stopped");
  },

  async shows_past_runs() {
    await page.click("#to-runs");
    await until("past runs", () => document.querySelectorAll("#runs-table tbody tr").length >= 4);
    await page.fill("#find", "run");
    await page.focus("#find");
    const stops = seen.stops;
    await page.keyboard.press("Space");
    await sleep(100);
    seen.typed = { stops: seen.stops - stops };
    await page.keyboard.press("Escape");
    await eventually("Esc is Stop in a text, too", () => seen.stops > stops);
    seen.typed.stops_with_escape = seen.stops - stops;
    await page.fill("#find", "");
    for (const tick of (await page.locator("#runs-table input").all()).slice(1)) {
      await tick.focus();
      await page.keyboard.press("Enter");
    }
    await until("two runs in the picture", () => document.querySelectorAll("#overlay-table tbody tr").length >= 3 && document.querySelector("#plot-overlay canvas"));
    await until("what rig compare says", () => document.querySelector("#compared .note"));
    seen.overlay = { table: await text("overlay-table"), compared: await text("compared") };
    await picture("runs");
    await hear("runs");
    await choose("Report");
    const frame = page.frameLocator("#report");
    await frame.locator("h1").first().waitFor();
    seen.report = { title: await frame.locator("h1").first().textContent(), sandbox: await page.getAttribute("#report", "sandbox"), stop: await page.isVisible("#stop") };
    await hear("report");
    await picture("report");
  },

  async calibrates_by_keyboard_alone() {
    copyFileSync(calibrate_config, config);
    const before = readFileSync(config, "utf8");
    const asked = (words) => until(`it asks ${words}`, ([words]) => document.getElementById("question")?.textContent.includes(words), words);
    const enter = () => page.keyboard.press("Enter");
    await page.evaluate(() => document.activeElement.blur());
    await choose("Calibrate");
    await until("a calibration may begin", () => !document.getElementById("calibrate-begin").disabled);
    await choose("Calibrate…");
    await asked("Which steps");
    await choose("Begin with these");
    await asked("by how many degrees".slice(3));
    await enter();
    await asked("Turn the shaft to the middle");
    await enter();
    for (const [number, angle] of ["-114", "4,5", "114"].entries()) {
      await asked(`Angle ${Math.min(number + 2, 3)}`);
      await until("the field is empty", () => document.querySelector("#answer .typed")?.value === "");
      await page.keyboard.type(angle);
      await enter();
      await until("it is taken or refused", ([said]) => document.getElementById("said").textContent.includes(said), angle === "4,5" ? "'4,5' is no angle" : `${angle}° at`);
    }
    await asked("Angle 4");
    await choose("No more angles");
    await asked("mechanical stops");
    await choose("Leave this step out");
    await asked("May the motor move");
    await choose("Yes");
    await asked("Swap the wires");
    seen.wiring = { title: await page.locator("#said figure svg title").textContent(), wires: await page.locator("#said figure path").count(), caption: await page.locator("#said figcaption").textContent(), code: await page.locator("#said code").first().textContent() };
    // this far down, with the rail at its end, on a wide page and on a narrow one
    seen.in_sight = {};
    const wide = page.viewportSize();
    for (const size of [wide, { width: 360, height: 740 }]) {
      await page.setViewportSize(size);
      await page.evaluate(() => document.getElementById("answer").scrollIntoView({ block: "nearest" }));
      seen.in_sight[size.width] = await page.evaluate(() => {
        const [stop, bar, question] = ["#stop", ".bar", "#answer"].map((one) => document.querySelector(one).getBoundingClientRect());
        const covers = stop.left < question.right && stop.top < question.bottom;
        return { stop_below_bar: stop.top >= bar.bottom, question: question.top >= bar.bottom && question.bottom <= innerHeight && !covers };
      });
      await picture(`wiring-${size.width}`);
    }
    await page.setViewportSize(wide);
    await hear("wiring");
    await picture("wiring");
    await choose("Reversed");
    await asked("May the motor move");
    await choose("Yes");
    await asked("Measure the dead band");
    await choose("No");
    await asked("Write this to");
    await choose("Yes");
    await says("calibrate-end", "is written");
    await picture("calibrated");
    const backup = (await text("calibrate-end")).split("as it was: ")[1];
    seen.calibrated = { said: await text("said"), focus: await page.evaluate(() => document.activeElement.id), config: readFileSync(config, "utf8"), kept: readFileSync(backup, "utf8") === before };
  },

  async jogs_until_the_wire_is_cut() {
    await page.click("#to-bench");
    copyFileSync(jog_config, config);
    const held = page;
    seen.cut = await jogUntil(async () => {
      held.cut = true;
      await says("silence", "Not connected");
    });
    Object.assign(seen.cut, { words: await text("silence"), stop: await text("stop-state"), held: await page.locator(".held").count() });
    await picture("silence");
    await page.mouse.up();
    held.cut = false;
    await until("connected again", () => document.getElementById("silence").hidden);
  },

  async jogs_until_the_tab_is_closed() {
    const other = await open(seen.context, new URL("/", url).href);
    const closing = page;
    await closing.bringToFront();
    seen.closed = await jogUntil(() => closing.close());
    page = other;
    await page.bringToFront();
    await until("connected", () => document.body.dataset.link === "alive");
  },

  async jogs_until_the_panel_is_killed() {
    seen.killed = await jogUntil(async () => {
      process.kill(panel_pid, "SIGKILL");
      await says("silence", "Not connected");
    });
    Object.assign(seen.killed, { words: await text("silence") });
    await page.mouse.up();
    // a Stop that cannot get through says so
    await page.locator("#stop").click();
    await says("stop-state", "did not get through");
    seen.killed.stop = await text("stop-state");
    await picture("killed");
  },

  async another_operator_takes_the_bench() {
    const pages = [];
    for (const username of ["one", "other"]) {
      const context = await browser.newContext({ httpCredentials: { username, password } });
      pages.push((page = await open(context, shared_url)));
      await until("connected", () => document.body.dataset.link === "alive" && document.getElementById("config-name").textContent !== "");
    }
    const [one, other] = pages;
    const drives = async () => Promise.all(pages.map((which) => which.isEnabled("#start")));
    seen.taken = { before: await drives(), words: await text("watcher") };
    page = other;
    await choose("Take the bench");
    await until("it drives", () => !document.getElementById("start").disabled);
    page = one;
    await until("it watches", () => document.getElementById("start").disabled && !document.getElementById("take").hidden);
    Object.assign(seen.taken, { after: await drives(), told: await text("watcher"), stop: await page.isEnabled("#stop") });
  },
};

const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: FLAGS });
seen.context = await browser.newContext({ viewport: { width: 1280, height: 800 }, reducedMotion: "reduce" });
try {
  for (const [name, step] of Object.entries(steps)) {
    const began_ms = performance.now();
    await step().catch((error) => {
      throw new Error(`${name}: ${error.message}`);
    });
    console.error(`${name}: ${Math.round(performance.now() - began_ms)} ms`);
  }
} catch (error) {
  seen.failed = error.message;
  seen.page = await page?.evaluate(() => document.body.innerText).catch(() => null);
} finally {
  delete seen.context;
  await browser.close();
}
console.log(JSON.stringify(seen));
