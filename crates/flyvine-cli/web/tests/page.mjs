// The page in a real Chromium: it opens, plays, obeys the keyboard, follows a live flight, aborts it, and its console
// stays clean. Run by web/tests/run. Screenshots are left beside this file's copy, in target/page-tests.

import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { cpSync, existsSync, mkdirSync, mkdtempSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

import { chromium } from "playwright-core";

const option = (name, otherwise) => {
  const i = process.argv.indexOf(`--${name}`);
  return i < 0 ? otherwise : process.argv[i + 1];
};
const flyvine = option("binary", process.env.FLYVINE);
/** A run folder of `flyvine demo`; made here if none is given. */
let runFolder = option("run", null);
const liveSeconds = Number(option("live-seconds", "6"));
const shots = dirname(fileURLToPath(import.meta.url));
const work = mkdtempSync(join(tmpdir(), "flyvine-page-"));
const file = (name) => join(work, name);
const DT = 0.05;

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM,
  args: [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader",
  ],
});
const started = [];
try {
  if (runFolder === null) run("demo", "--out", (runFolder = file("run")));
  await views();
  await severalRuns();
  await report();
  await guards();
  await live();
  await aborts();
  console.log("the page passes");
} finally {
  started.forEach((child) => child.kill());
  await browser.close();
}

/** Runs a command to its end. */
function run(...args) {
  const { status, stderr } = spawnSync(flyvine, args, { cwd: work, encoding: "utf8" });
  assert.ok(status === 0 || status === 3, `flyvine ${args.join(" ")}: ${status}\n${stderr}`);
}

/** Starts a command that serves a page; resolves to its address and its end. */
function serve(...args) {
  const child = spawn(flyvine, [...args, "--no-open"], { cwd: work });
  started.push(child);
  const ended = new Promise((resolve) => child.on("exit", resolve));
  const url = new Promise((resolve, reject) => {
    let heard = "";
    const listen = (data) => {
      heard += data;
      const found = /http:\/\/127\.0\.0\.1:\d+\/[0-9a-f]{32}\//.exec(heard);
      if (found) resolve(found[0]);
    };
    child.stdout.on("data", listen);
    child.stderr.on("data", listen);
    ended.then((code) => reject(new Error(`exit code ${code}: ${heard}`)));
  });
  return { url, ended, child };
}

/** Opens a page; everything that its console complains about fails the test. */
async function open(url, options = {}) {
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 }, ...options });
  page.complaints = [];
  page.on("console", (message) => {
    // Chromium's own remark on software rendering is not the page's.
    if (["error", "warning"].includes(message.type()) && !/GPU stall|swiftshader/i.test(message.text())) {
      page.complaints.push(message.text());
    }
  });
  page.on("pageerror", (error) => page.complaints.push(error.stack));
  const before = performance.now();
  await page.goto(url);
  await page.waitForFunction(() => globalThis.flyvine && !globalThis.flyvine.dirty);
  page.readyMs = performance.now() - before;
  return page;
}

/** A minute of made-up flight, 1201 rows. */
function minute() {
  const rows = ["t_s,length_m,pressure_kpa,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,qr_qw,qr_qx,qr_qy,qr_qz,ee_x,ee_y,ee_z"];
  for (let k = 0; k <= 1200; k++) {
    const t = k * DT;
    const at = (lag) => [Math.sin(0.8 * (t - lag)), 0.5 * Math.sin(1.6 * (t - lag)), 1.5];
    const [c, q, e] = [at(0), at(0.4), at(0.7)];
    rows.push([t.toFixed(2), 0.7, 0, ...c, ...q, 1, 0, 0, 0, e[0], e[1], 0.8].join(","));
  }
  writeFileSync(file("minute.csv"), `${rows.join("\n")}\n`);
}

async function views() {
  minute();
  const { url, child } = serve("view", "minute.csv");
  const page = await open(await url);
  console.log(`first view of a 60-s flight: ${page.readyMs.toFixed(0)} ms`);
  assert.equal(await page.evaluate(() => flyvine.lastRow), 1200);
  assert.ok(await page.locator("#no-plan").isVisible(), "a flight without plan says so");
  await page.screenshot({ path: join(shots, "minute.png") });
  assert.deepEqual(page.complaints, []);
  await page.close();
  child.kill();

  const demo = serve("view", runFolder);
  const shown = await open(await demo.url);
  console.log(`first view of a run with 13 flights: ${shown.readyMs.toFixed(0)} ms`);
  await keyboard(shown);
  await looks(shown);
  assert.deepEqual(shown.complaints, []);
  await shown.close();
  demo.child.kill();
}

async function keyboard(page) {
  const row = () => page.evaluate(() => flyvine.row);
  const shown = () => page.evaluate(() => flyvine.shown);
  await page.keyboard.press("Space");
  await page.waitForFunction(() => flyvine.row > 3);
  await page.keyboard.press("Space");
  const paused = await row();
  await page.waitForTimeout(300);
  assert.equal(await row(), paused, "paused");
  await page.keyboard.press("Home");
  assert.equal(await row(), 0);
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Shift+ArrowRight");
  assert.equal(await row(), 21);
  await page.keyboard.press("ArrowLeft");
  assert.equal(await row(), 20);
  await page.keyboard.press("End");
  assert.equal(await row(), await page.evaluate(() => flyvine.lastRow));
  await page.keyboard.press("9");
  assert.deepEqual(await shown(), [8]);
  await page.keyboard.press("Shift+1");
  assert.deepEqual(await shown(), [8, 0]);
  await page.keyboard.press("Shift+9");
  assert.deepEqual(await shown(), [0]);
  await page.keyboard.press("]");
  assert.deepEqual(await shown(), [1]);
  await page.keyboard.press("v");
  assert.equal(await page.evaluate(() => flyvine.scene.view), "side");
  await page.keyboard.press("?");
  assert.ok(await page.locator("#help").isVisible());
  await page.keyboard.press("Escape");
  assert.ok(!(await page.locator("#help").isVisible()));
  // Tab reaches a control, and the control keeps its key.
  await page.locator("#loop").focus();
  await page.keyboard.press("Space");
  assert.ok(await page.locator("#loop").isChecked());
  assert.equal(await page.evaluate(() => flyvine.playing), false);
  await page.keyboard.press("l");
}

async function looks(page) {
  const colors = () =>
    page.evaluate(() => {
      flyvine.scene.render();
      const gl = flyvine.scene.renderer.getContext();
      const pixels = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
      gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      const found = new Set();
      for (let i = 0; i < pixels.length; i += 4) found.add((pixels[i] << 16) | (pixels[i + 1] << 8) | pixels[i + 2]);
      return found.size;
    });
  await page.keyboard.press("1");
  await page.evaluate(() => { flyvine.setView("orbit"); flyvine.seek(90); });
  assert.ok((await colors()) > 100, "something is drawn");
  assert.ok((await page.evaluate(() => flyvine.first.paperPaths.length)) === 2, "the paper's paths are there");
  const inside = await page.evaluate(() => {
    const box = document.querySelector(".uplot").getBoundingClientRect();
    const head = document.querySelector(".playhead").getBoundingClientRect();
    return head.left > box.left && head.left < box.right;
  });
  assert.ok(inside, "the playhead is in its plot");
  // A drag in a plot moves in time.
  const plot = await page.locator(".u-over").first().boundingBox();
  await page.mouse.move(plot.x + plot.width / 2, plot.y + 20);
  await page.mouse.down();
  await page.mouse.up();
  const middle = await page.evaluate(() => flyvine.row / (flyvine.first.knots - 1));
  assert.ok(Math.abs(middle - 0.5) < 0.02, `${middle}`);
  await page.screenshot({ path: join(shots, "lemniscate.png") });
  await page.keyboard.press("9");
  await page.evaluate(() => { flyvine.setView("side"); flyvine.seek(25); });
  await page.screenshot({ path: join(shots, "swing.png") });
  await page.keyboard.press("t");
  for (const key of ["1", "Shift+5", "Shift+3"]) await page.keyboard.press(key);
  await page.evaluate(() => { flyvine.setView("orbit"); flyvine.seek(70); });
  await page.screenshot({ path: join(shots, "compare-dark.png") });
  await page.setViewportSize({ width: 420, height: 900 });
  await page.waitForTimeout(200);
  const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert.ok(overflow <= 0, `a narrow window scrolls sideways by ${overflow} px`);
  await page.screenshot({ path: join(shots, "narrow.png") });
}

/** Flights of several runs stand side by side, each with where it is from. */
async function severalRuns() {
  const experiment = (name) => join(runFolder, "experiments", name);
  const runs = [file("one"), file("two")];
  for (const folder of runs) {
    mkdirSync(join(folder, "experiments"), { recursive: true });
    cpSync(experiment("lemniscate_10s_ES"), join(folder, "experiments", "lemniscate_10s_ES"), { recursive: true });
  }
  const { url, child } = serve("view", ...runs);
  const page = await open(await url);
  const titles = await page.evaluate(() => flyvine.flights.map((flight) => flight.title.split(": ")[0]));
  assert.deepEqual(titles, ["one", "two"]);
  await page.keyboard.press("Shift+2");
  assert.deepEqual(await page.evaluate(() => flyvine.shown), [0, 1]);
  assert.deepEqual(page.complaints, []);
  await page.close();
  child.kill();
}

/** The report's own replay works from a file, and at 1200 px no table needs to be scrolled sideways. */
async function report() {
  const page = await browser.newPage({ viewport: { width: 1200, height: 900 } });
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(error.stack));
  await page.goto(pathToFileURL(join(runFolder, "report.html")).href);
  const time = page.locator("#replay-time");
  const start = await time.textContent();
  assert.match(start, /^0\.00 s of /);
  await page.locator("#replay-play").click();
  await page.waitForFunction((start) => document.getElementById("replay-time").textContent !== start, start);
  const hidden = await page.evaluate(() =>
    [...document.querySelectorAll(".scroll")].map((box) => box.scrollWidth - box.clientWidth).filter((px) => px > 0),
  );
  assert.deepEqual(hidden, [], "pixels of tables that are out of sight");
  await page.screenshot({ path: join(shots, "report.png") });
  assert.deepEqual(complaints, []);
  await page.close();
}

/** The address is secret, and only pages of this server may ask. */
async function guards() {
  const { url, child } = serve("view", "minute.csv");
  const address = await url;
  const { origin } = new URL(address);
  const status = async (target, init) => (await fetch(target, init)).status;
  assert.equal(await status(address), 200);
  assert.equal(await status(`${origin}/`), 403);
  assert.equal(await status(`${origin}/${"0".repeat(32)}/data.json`), 403);
  assert.equal(await status(address, { headers: { Origin: "http://example.org" } }), 403);
  assert.equal(await status(`${address}abort`, { method: "POST" }), 405, "there is nothing to abort");
  assert.equal(await status(`${address}../../Cargo.toml`), 403);
  child.kill();
}

/** Plans a flight of some seconds. */
function planFor(seconds) {
  const points = [];
  for (let t = 3; t < seconds; t += 3) {
    points.push(`{ t_s = ${t.toFixed(1)}, end_effector = [${(0.7 * Math.sin(t)).toFixed(3)}, ${(0.4 * Math.cos(2 * t)).toFixed(3)}, 0.8] }`);
  }
  points.push(`{ t_s = ${seconds.toFixed(1)}, end_effector = [0.0, 0.0, 0.8] }`);
  writeFileSync(
    file("task.toml"),
    `name = "live"\n[configuration]\nlength_m = 0.7\npressure_kpa = 0.0\n[waypoints]\npoints = [\n${points.join(",\n")}\n]\n`,
  );
  run("plan", "task.toml", "--bank", join(runFolder, "bank.json"), "--out", "plan.json");
}

async function live() {
  planFor(liveSeconds);
  const knots = Math.round(liveSeconds / DT) + 1;
  const flight = serve("fly", "plan.json", "--vehicle", "sim", "--out", "live.mcap", "--live");
  const page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
  // Taken from the first row on: what comes when, and which row is on the screen when. A row is due at its time after
  // the start, and the start is what the promptest row says.
  await page.addInitScript((dt) => {
    globalThis.record = { arrivals: [], arrivedMs: [], frames: [] };
    const wait = setInterval(() => {
      const app = globalThis.flyvine;
      if (!app) return;
      clearInterval(wait);
      const addRows = app.addRows.bind(app);
      app.addRows = (rows) => {
        record.arrivals.push(...rows.map((row) => row.row));
        record.arrivedMs.push(performance.now() - 1000 * dt * rows[rows.length - 1].row);
        addRows(rows);
      };
      const watch = (now) => {
        if (record.arrivals.length > 0 && app.live) record.frames.push([now, app.row]);
        requestAnimationFrame(watch);
      };
      requestAnimationFrame(watch);
    }, 1);
  }, DT);
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(error.stack));
  await page.goto(await flight.url);
  await page.waitForFunction(() => globalThis.flyvine?.first?.rows > 40);
  await page.screenshot({ path: join(shots, "live.png") });
  assert.equal(await flight.ended, 0);
  await page.waitForFunction(() => !flyvine.live);
  const { rows, behind, arrivals, state } = await page.evaluate((dt) => {
    const startMs = Math.min(...record.arrivedMs);
    return {
      rows: flyvine.first.rows,
      behind: record.frames.map(([now, row]) => (now - startMs) / (1000 * dt) - row),
      arrivals: record.arrivals,
      state: document.getElementById("live-state").textContent,
    };
  }, DT);
  assert.equal(rows, knots);
  assert.deepEqual(arrivals, Array.from({ length: knots }, (_, k) => k), "every row, once, in order");
  assert.equal(state, "flown to the end");
  const sorted = [...behind].sort((a, b) => a - b);
  const quantile = (q) => (1000 * DT * sorted[Math.floor(q * (sorted.length - 1))]).toFixed(0);
  console.log(
    `live, ${liveSeconds} s at 20 Hz: ${rows} rows, ${behind.length} frames; on screen after ${quantile(0.5)} ms (median), ` +
      `${quantile(0.95)} ms (95 %), ${quantile(1)} ms (worst)`,
  );
  if (liveSeconds < 60) {
    // Too short, and on a shared machine, to say more than that every row came.
    assert.deepEqual(complaints, []);
    await page.close();
    return;
  }
  const mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;
  const third = Math.floor(behind.length / 3);
  const growth = mean(behind.slice(-third)) - mean(behind.slice(0, third));
  assert.ok(growth < 10, `it falls behind: by ${growth.toFixed(1)} rows over the flight`);
  assert.deepEqual(complaints, []);
  await page.close();
}

async function aborts() {
  const flight = serve("fly", "plan.json", "--vehicle", "sim", "--out", "aborted.mcap", "--live");
  const page = await open(await flight.url);
  await page.waitForFunction(() => globalThis.flyvine?.first?.rows > 20);
  await page.keyboard.press("a");
  assert.equal(await flight.ended, 3, "an aborted flight is not to be trusted");
  await page.waitForFunction(() => !flyvine.live);
  const state = await page.locator("#live-state").textContent();
  assert.match(state, /stopped by the operator/);
  assert.ok(existsSync(file("aborted.mcap")), "its recording is kept");
  await page.screenshot({ path: join(shots, "aborted.png") });
  assert.deepEqual(page.complaints, []);
  await page.close();
}
