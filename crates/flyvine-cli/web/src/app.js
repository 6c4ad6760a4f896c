// @ts-check
// The page: which flights are shown, where in time, how fast; and what the keys do.

import { Flight } from "./flight.js";
import { follow, requestAbort } from "./live.js";
import { Plots, toneOf } from "./plots.js";
import { LAYERS, Scene } from "./scene.js";
import { distinctColors, onTheme, toggleTheme } from "./theme.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const VIEW_NAMES = ["orbit", "side", "top", "follow"];
/** Plots of a live flight are drawn this often at most, ms; and where frames are slow. */
const LIVE_PLOTS_MS = 100;
const SLOW_LIVE_PLOTS_MS = 500;
/** Frames this slow, this many in a row, are drawn more simply from then on. */
const SLOW_FRAME_MS = 90;
const SLOW_FRAMES = 6;

const find = (/** @type {string} */ id) => /** @type {any} */ (document.getElementById(id));

class Page {
  /** @param {any} content data.json */
  constructor(content) {
    /** @type {number} */ this.dt = content.dt;
    /** @type {Flight[]} */ this.flights = content.flights.map((/** @type {any} */ raw) => new Flight(raw, content.dt));
    /** @type {boolean} */ this.live = content.live;
    /** @type {number[]} indices of the shown flights, the first one with its plan */ this.shown = [];
    /** @type {"reference" | "predicted"} */ this.against = "reference";
    this.row = 0;
    this.playing = false;
    this.speed = 1;
    /** Whether the playhead sticks to the newest row. */ this.following = this.live;
    this.dirty = true;
    /** @type {number | null} */ this.lastTick = null;
    /** @type {number | null} when the last frame was drawn, if the one before it was, too */ this.lastFrame = null;
    this.slowFrames = 0;
    this.livePlotsMs = LIVE_PLOTS_MS;
    /** @type {number | null} when the plots lack rows, since when, ms */ this.plotsDueSince = null;
    this.scene = makeScene(() => { this.dirty = true; });
    this.plots = new Plots(find("panels"), (row) => { this.pause(); this.seek(row); });
    document.title = find("title").textContent = content.title;
    document.querySelector("main")?.classList.toggle("single", this.flights.length < 2);
    this.addFlightList();
    this.addControls();
    this.addKeys();
  }

  get first() {
    return this.flights[this.shown[0]];
  }

  get shownFlights() {
    return this.shown.map((i) => this.flights[i]);
  }

  /** Last row that can be shown: of the longest shown flight. */
  get lastRow() {
    return Math.max(0, ...this.shownFlights.map((flight) => flight.rows - 1));
  }

  // ---- which flights

  addFlightList() {
    this.flights.forEach((flight, i) => {
      const item = document.createElement("li");
      const box = document.createElement("input");
      box.type = "checkbox";
      box.setAttribute("aria-label", `Compare ${flight.title}`);
      box.addEventListener("change", () => this.toggle(i));
      const button = document.createElement("button");
      button.type = "button";
      button.title = i < 9 ? `Key ${i + 1}` : "";
      button.addEventListener("click", () => this.show([i]));
      const name = document.createElement("span");
      name.className = "name";
      name.textContent = flight.title;
      const error = document.createElement("span");
      error.className = "error";
      const summary = flight.summary(flight.judgedBy);
      error.textContent = summary ? `${summary.mean.toFixed(1)} cm` : "";
      error.title = `mean error to the ${wordFor(flight.judgedBy)}`;
      button.append(name, error);
      if (flight.remark) {
        const remark = document.createElement("span");
        remark.className = "remark";
        remark.textContent = flight.remark;
        button.append(remark);
      }
      item.append(box, button);
      find("flights").append(item);
    });
  }

  /** @param {number} i adds or removes a flight of the comparison */
  toggle(i) {
    if (!this.shown.includes(i)) this.show([...this.shown, i]);
    else if (this.shown.length > 1) this.show(this.shown.filter((j) => j !== i));
    else this.show(this.shown); // one stays
  }

  /** @param {number[]} shown */
  show(shown) {
    const before = this.first;
    this.shown = shown;
    const colors = distinctColors(this.shownFlights.map((flight) => flight.baseColor));
    this.shownFlights.forEach((flight, i) => { flight.color = colors[i]; });
    if (this.first !== before) this.against = this.first.judgedBy;
    find("against").value = this.against;
    this.row = Math.min(this.row, this.lastRow);
    this.redraw();
    announce(`${this.shownFlights.map((flight) => flight.title).join(", ")}`);
  }

  /** Everything that depends on the flights and the colours. */
  redraw() {
    [...find("flights").children].forEach((item, i) => {
      const isShown = this.shown.includes(i);
      item.style.setProperty("--swatch", isShown ? onTheme(this.flights[i].color) : "");
      item.querySelector("input").checked = isShown;
      item.querySelector("button").setAttribute("aria-pressed", String(isShown));
    });
    this.scene?.show(this.shownFlights);
    this.plots.show(this.shownFlights, this.against);
    find("no-plan").hidden = this.first.hasPlan;
    find("against").closest("label").hidden = !this.first.hasPlan;
    this.drawLegend();
    this.drawReadoutFrame();
    this.drawMarks();
    find("scrubber").max = Math.max(1, this.lastRow);
    this.seek(this.row);
  }

  drawLegend() {
    const { first } = this;
    const entries = this.shownFlights.map((flight) => ["", onTheme(flight.color), this.shown.length > 1 ? flight.title : "flown"]);
    if (first.hasPlan) {
      entries.push(["dashed", "var(--warn)", "plan's prediction"], ["dotted", "var(--ink)", "reference"]);
    }
    entries.push(["thin", "var(--ink)", "command"]);
    if (first.paperSeries.length > 0) entries.push(["halo", onTheme(first.color), "paper, measured on hardware"]);
    else if (first.published) entries.push(["halo", onTheme(first.color), "paper's mean error, on hardware"]);
    find("legend").replaceChildren(...entries.map(([kind, color, text]) => {
      const item = document.createElement("li");
      item.append(swatch(kind, color), text);
      return item;
    }));
  }

  drawMarks() {
    const knots = Math.max(1, this.lastRow);
    const mark = (/** @type {number} */ row, /** @type {string} */ kind) => {
      const element = document.createElement("i");
      element.className = kind;
      element.style.left = `${(100 * row) / knots}%`;
      return element;
    };
    const { first } = this;
    const marks = first.targetKnot !== null && first.targetKnot <= knots ? [mark(first.targetKnot, "target")] : [];
    find("marks").replaceChildren(...marks);
  }

  // ---- where in time

  /** @param {number} row */
  seek(row) {
    this.row = Math.min(Math.max(row, 0), this.lastRow);
    this.scene?.update(this.row);
    this.plots.seek(this.row);
    this.showNumbers();
    this.dirty = true;
  }

  drawReadoutFrame() {
    const head = this.first.hasPlan
      ? `<thead><tr><th></th><th>error</th><th>mean</th><th>max</th><th>tilt</th></tr></thead>`
      : `<thead><tr><th></th><th>tilt</th></tr></thead>`;
    find("readout").innerHTML = `${head}<tbody></tbody>`;
    find("readout").classList.toggle("single", this.shown.length === 1);
    for (const flight of this.shownFlights) {
      const row = document.createElement("tr");
      row.style.setProperty("--swatch", onTheme(flight.color));
      const name = document.createElement("th");
      name.textContent = flight.title;
      row.append(name, ...Array.from({ length: this.first.hasPlan ? 4 : 1 }, () => document.createElement("td")));
      find("readout").tBodies[0].append(row);
    }
  }

  showNumbers() {
    const k = Math.floor(this.row + 1e-6);
    const time = `${(this.row * this.dt).toFixed(2)} s`;
    const total = ` of ${(this.lastRow * this.dt).toFixed(2)} s`;
    find("time").innerHTML = `${time}<span class="total">${total}</span>`;
    const scrubber = find("scrubber");
    scrubber.value = this.row;
    scrubber.setAttribute("aria-valuetext", time + total);
    this.shownFlights.forEach((flight, i) => {
      const tilt = k < flight.rows ? flight.tilt(k) : null;
      const texts = [tilt === null ? "–" : `${tilt.toFixed(0)}°`];
      if (this.first.hasPlan) {
        const error = flight.errors[this.against][k];
        const summary = flight.summary(this.against);
        texts.unshift(
          error === null || error === undefined ? "–" : `${error.toFixed(1)} cm`,
          summary ? `${summary.mean.toFixed(1)}` : "–",
          summary ? `${summary.largest.toFixed(1)}` : "–",
        );
      }
      const cells = find("readout").tBodies[0].rows[i].cells;
      texts.forEach((text, j) => { cells[j + 1].textContent = text; });
    });
  }

  /** @param {boolean} playing */
  play(playing) {
    if (playing && this.row >= this.lastRow) this.seek(0);
    this.playing = playing;
    this.following = false;
    this.lastTick = null;
    const button = find("play");
    button.querySelector("[aria-hidden]").textContent = playing ? "❚❚" : "▶";
    button.querySelector(".word").textContent = playing ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(playing));
    find("to-live").hidden = !this.live;
  }

  pause() {
    this.play(false);
  }

  /** @param {number} speed */
  setSpeed(speed) {
    this.speed = speed;
    find("speed").value = String(speed);
  }

  /** @param {number} steps */
  shiftSpeed(steps) {
    const i = SPEEDS.indexOf(this.speed) + steps;
    this.setSpeed(SPEEDS[Math.min(Math.max(i, 0), SPEEDS.length - 1)]);
    announce(`speed ${this.speed}`);
  }

  /** @param {number} now ms */
  tick(now) {
    if (this.playing) {
      const elapsed = this.lastTick === null ? 0 : Math.min((now - this.lastTick) / 1000, 0.25);
      this.lastTick = now;
      const row = this.row + (this.speed * elapsed) / this.dt;
      if (row < this.lastRow) this.seek(row);
      else if (find("loop").checked) this.seek(0);
      else {
        this.seek(this.lastRow);
        this.pause();
      }
    }
    if (this.plotsDueSince !== null && now - this.plotsDueSince >= this.livePlotsMs) {
      this.plotsDueSince = null;
      this.plots.grow();
      this.scene?.grow();
    }
    if (this.dirty) {
      this.dirty = false;
      this.scene?.render();
      this.watchFrames(now);
    } else {
      this.lastFrame = null;
    }
    requestAnimationFrame((time) => this.tick(time));
  }

  /** @param {number} now ms; draws more simply where frames are slow */
  watchFrames(now) {
    const isSlow = this.lastFrame !== null && now - this.lastFrame > SLOW_FRAME_MS;
    this.slowFrames = isSlow ? this.slowFrames + 1 : 0;
    this.lastFrame = now;
    if (this.slowFrames === SLOW_FRAMES && this.livePlotsMs === LIVE_PLOTS_MS) {
      this.livePlotsMs = SLOW_LIVE_PLOTS_MS;
      this.scene?.simplify();
    }
  }

  // ---- controls and keys

  addControls() {
    find("play").addEventListener("click", () => this.play(!this.playing));
    find("scrubber").addEventListener("input", (/** @type {any} */ event) => {
      this.pause();
      this.seek(Number(event.target.value));
    });
    for (const speed of SPEEDS) find("speed").add(new Option(`${speed} ×`, String(speed)));
    find("speed").addEventListener("change", (/** @type {any} */ event) => this.setSpeed(Number(event.target.value)));
    this.setSpeed(1);
    find("against").addEventListener("change", (/** @type {any} */ event) => {
      this.against = event.target.value;
      this.redraw();
    });
    for (const button of document.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => this.setView(/** @type {HTMLElement} */ (button).dataset.view ?? "orbit"));
    }
    this.addLayers();
    find("theme").addEventListener("click", () => this.toggleTheme());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.retheme());
    find("help-open").addEventListener("click", () => find("help").showModal());
    find("to-live").addEventListener("click", () => this.followNewest());
    find("abort").addEventListener("click", () => this.abort());
    new ResizeObserver(() => {
      this.scene?.resize();
      this.scene?.render();
    }).observe(find("scene"));
  }

  addLayers() {
    /** @type {Record<string, [string, string]>} */
    const swatches = {
      reference: ["thin", "var(--ink)"], prediction: ["", "var(--warn)"], paper: ["halo", "var(--muted)"],
      path: ["", "var(--accent)"], command: ["diamond", ""], error: ["", "var(--bad)"],
    };
    for (const layer of LAYERS) {
      const label = document.createElement("label");
      const box = document.createElement("input");
      box.type = "checkbox";
      box.checked = true;
      box.addEventListener("change", () => {
        this.scene?.setLayer(layer, box.checked);
        this.dirty = true;
      });
      label.append(box, swatch(...swatches[layer]), layer);
      find("layers").append(label);
    }
  }

  /** @param {string} view */
  setView(view) {
    this.scene?.setView(view);
    this.dirty = true;
    for (const button of document.querySelectorAll("[data-view]")) {
      button.setAttribute("aria-pressed", String(/** @type {HTMLElement} */ (button).dataset.view === view));
    }
    announce(`view: ${view === "orbit" ? "3-D" : view}`);
  }

  toggleTheme() {
    toggleTheme();
    this.retheme();
  }

  retheme() {
    this.scene?.setTheme();
    this.redraw();
  }

  addKeys() {
    /** @type {Record<string, (event: KeyboardEvent) => void>} */
    const keys = {
      " ": () => this.play(!this.playing),
      ArrowLeft: (event) => { this.pause(); this.seek(Math.ceil(this.row) - (event.shiftKey ? 20 : 1)); },
      ArrowRight: (event) => { this.pause(); this.seek(Math.floor(this.row) + (event.shiftKey ? 20 : 1)); },
      ArrowUp: () => this.shiftSpeed(1),
      ArrowDown: () => this.shiftSpeed(-1),
      Home: () => { this.pause(); this.seek(0); },
      End: () => (this.live ? this.followNewest() : (this.pause(), this.seek(this.lastRow))),
      "[": () => this.showNeighbour(-1),
      "]": () => this.showNeighbour(1),
      v: () => this.setView(VIEW_NAMES[(VIEW_NAMES.indexOf(this.scene?.view ?? "orbit") + 1) % VIEW_NAMES.length]),
      l: () => { find("loop").checked = !find("loop").checked; announce(find("loop").checked ? "loop" : "no loop"); },
      t: () => this.toggleTheme(),
      a: () => { if (this.live) this.abort(); },
      "?": () => find("help").showModal(),
    };
    document.addEventListener("keydown", (event) => {
      const target = /** @type {Element} */ (event.target);
      if (event.ctrlKey || event.altKey || event.metaKey || find("help").open || target.closest("select, textarea")) return;
      // A focused control keeps the keys that work it.
      if (event.key === " " && target.closest("button, [type=checkbox]")) return;
      const digit = /^Digit([1-9])$/.exec(event.code);
      if (digit) {
        const i = Number(digit[1]) - 1;
        if (i < this.flights.length) event.shiftKey ? this.toggle(i) : this.show([i]);
        return;
      }
      const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      event.preventDefault();
      action(event);
    });
  }

  /** @param {number} step */
  showNeighbour(step) {
    const count = this.flights.length;
    this.show([(this.shown[0] + step + count) % count]);
  }

  // ---- live

  startLive() {
    find("live").hidden = false;
    for (const element of document.querySelectorAll(".live-only")) /** @type {HTMLElement} */ (element).hidden = false;
    this.setLiveState("waiting", "warn");
    follow({
      onRows: (rows) => this.addRows(rows),
      onEnd: (end) => this.endLive(end.text, end.completed ? "good" : "bad"),
      onLost: () => this.endLive("connection lost", "bad"),
    });
  }

  /** @param {any[]} rows */
  addRows(rows) {
    const flight = this.flights[0];
    const hadNone = flight.rows === 0;
    for (const row of rows) {
      flight.append(row);
      for (const event of row.events) this.addEvent(event);
    }
    const newest = rows[rows.length - 1];
    this.setLiveState(newest.reason ? `${newest.state}: ${newest.reason}` : newest.state, toneOf(newest.state));
    find("live-facts").textContent = `row ${newest.row + 1} of ${newest.knots}${newest.dropped ? `, ${newest.dropped} not shown` : ""}`;
    find("scrubber").max = Math.max(1, this.lastRow);
    if (hadNone) this.redraw(); // status lanes appear with the first row
    this.plotsDueSince ??= performance.now();
    if (this.following) this.seek(this.lastRow);
    else this.showNumbers();
  }

  /** @param {string} text */
  addEvent(text) {
    const item = document.createElement("li");
    item.textContent = text;
    find("events").hidden = false;
    find("events").append(item);
    item.scrollIntoView({ block: "nearest" });
  }

  followNewest() {
    this.pause();
    this.following = true;
    find("to-live").hidden = true;
    this.seek(this.lastRow);
  }

  async abort() {
    if (find("abort").disabled) return;
    find("abort").disabled = true;
    const heard = await requestAbort();
    this.addEvent(heard ? "abort requested from this page" : "the abort request did NOT reach the flight loop");
    // It may be pressed again until the flight loop has heard it.
    find("abort").disabled = heard;
  }

  /**
   * @param {string} text
   * @param {string} tone
   */
  setLiveState(text, tone) {
    const pill = find("live-state");
    if (pill.textContent !== text) pill.textContent = text;
    pill.dataset.tone = tone;
  }

  /**
   * @param {string} text
   * @param {string} tone
   */
  endLive(text, tone) {
    this.live = false;
    this.setLiveState(text, tone);
    find("abort").hidden = true;
    find("to-live").hidden = true;
    this.redraw();
  }
}

/** @param {() => void} onViewChanged */
function makeScene(onViewChanged) {
  if (document.createElement("canvas").getContext("webgl2")) return new Scene(find("scene"), onViewChanged);
  find("no-webgl").hidden = false;
  find("scene").hidden = true;
  return null;
}

/**
 * @param {string} kind
 * @param {string} color
 */
function swatch(kind, color) {
  const element = document.createElement("i");
  element.className = `swatch ${kind}`;
  element.style.setProperty("--swatch", color);
  return element;
}

/** @param {"reference" | "predicted"} against */
function wordFor(against) {
  return against === "reference" ? "reference" : "prediction";
}

/** @param {string} text for screen readers */
function announce(text) {
  find("announce").textContent = text;
}

const content = await (await fetch(new URL("data.json", new URL(".", location.href)))).json();
const page = new Page(content);
page.show([0]);
requestAnimationFrame((now) => page.tick(now));
if (page.live) page.startLive();
// For tests, and for the curious: the page from the browser's console.
Object.assign(globalThis, { flyvine: page });
