// @ts-check
// Plots over time, locked to the replay: one time axis, one playhead; dragging in a plot moves in time.

import { AXES } from "./flight.js";
import { onTheme, themeColor } from "./theme.js";

/** @typedef {import("./flight.js").Flight} Flight */
/** @type {any} uPlot, from vendor/uPlot.iife.min.js */
const UPlot = /** @type {any} */ (globalThis).uPlot;

/**
 * @typedef {(number | null | undefined)[]} Values  one per row
 * @typedef {{values: () => Values, stroke: string, width: number, dash?: number[], steps?: boolean, read?: boolean}} Curve
 *   `read`: its value at the playhead is printed
 * @typedef {{caption: string, unit: string, digits: number, curves: Curve[], height?: number, fromZero?: boolean, least?: number}} Panel
 *   `least`: the smallest span of the vertical axis
 */

const LEFT = 52;
const RIGHT = 16;
const LANE_COLORS = { good: "--good", warn: "--warn", bad: "--bad" };

export class Plots {
  /**
   * @param {HTMLElement} container
   * @param {(row: number) => void} onSeek
   */
  constructor(container, onSeek) {
    this.container = container;
    this.onSeek = onSeek;
    /** @type {{plot: any, panel: Panel, playhead: HTMLElement, values: HTMLElement}[]} */ this.panels = [];
    /** @type {{canvas: HTMLCanvasElement, tone: (row: number) => string | null}[]} */ this.lanes = [];
    /** @type {Flight[]} */ this.flights = [];
    this.row = 0;
    new ResizeObserver(() => this.resize()).observe(container);
  }

  /**
   * @param {Flight[]} flights the first one's plan is drawn, too
   * @param {"reference" | "predicted"} against
   */
  show(flights, against) {
    for (const { plot } of this.panels) plot.destroy();
    this.container.replaceChildren();
    this.panels = [];
    this.lanes = [];
    this.flights = flights;
    if (flights.length === 0) return;
    this.steps = new Map(flights[0].steps.map((step) => [step.row, step]));
    for (const [heading, panels, lanes] of groups(flights, against)) {
      const group = document.createElement("div");
      group.className = "group";
      const title = document.createElement("h3");
      title.textContent = heading;
      group.append(title);
      panels.forEach((panel, i) => this.add(group, panel, i === panels.length - 1));
      for (const lane of lanes ?? []) this.addLane(group, lane.name, lane.tone);
      this.container.append(group);
    }
    this.resize();
    this.seek(this.row);
  }

  /**
   * @param {HTMLElement} group
   * @param {Panel} panel
   * @param {boolean} isLast whether it carries the time axis
   */
  add(group, panel, isLast) {
    const box = document.createElement("div");
    box.className = "panel";
    const caption = document.createElement("div");
    caption.className = "caption";
    const name = document.createElement("span");
    name.textContent = panel.caption;
    const values = document.createElement("span");
    values.className = "values";
    caption.append(name, values);
    const body = document.createElement("div");
    box.append(caption, body);
    group.append(box);
    const [muted, line] = [themeColor("--muted"), themeColor("--line")];
    const font = "11px system-ui, sans-serif";
    const axis = { stroke: muted, font, grid: { stroke: line, width: 1 }, ticks: { show: false } };
    const plot = new UPlot(
      {
        width: Math.max(this.container.clientWidth, 200),
        height: (panel.height ?? 84) + (isLast ? 20 : 0),
        padding: [5, RIGHT, isLast ? 0 : 5, 0],
        legend: { show: false },
        cursor: { show: false },
        scales: {
          x: { time: false, range: () => [0, Math.max(this.lastRow() * this.flights[0].dt, 1e-3)] },
          y: { range: (/** @type {any} */ _, /** @type {number} */ low, /** @type {number} */ high) => padded(low, high, panel) },
        },
        axes: [
          { ...axis, size: isLast ? 20 : 0, gap: 2, space: 55, values: isLast ? seconds : () => [] },
          { ...axis, size: LEFT, gap: 5, space: 24, values: numbers },
        ],
        series: [
          {},
          ...panel.curves.map(({ stroke, width, dash, steps }) => ({
            stroke, width, dash, points: { show: false }, spanGaps: false,
            ...(steps ? { paths: UPlot.paths.stepped({ align: 1 }) } : {}),
          })),
        ],
      },
      this.data(panel),
      body,
    );
    const playhead = document.createElement("div");
    playhead.className = "playhead";
    plot.over.append(playhead);
    this.makeDraggable(plot);
    this.panels.push({ plot, panel, playhead, values });
  }

  /**
   * A strip of colours over time.
   * @param {HTMLElement} group
   * @param {string} name
   * @param {(row: number) => string | null} tone
   */
  addLane(group, name, tone) {
    const lane = document.createElement("div");
    lane.className = "lane";
    const label = document.createElement("span");
    label.textContent = name;
    const canvas = document.createElement("canvas");
    canvas.style.marginRight = `${RIGHT}px`;
    canvas.style.width = `calc(100% - ${RIGHT}px)`;
    lane.append(label, canvas);
    group.append(lane);
    this.lanes.push({ canvas, tone });
  }

  /** @param {any} plot */
  makeDraggable(plot) {
    const seek = (/** @type {PointerEvent} */ event) => {
      const time = plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x");
      this.onSeek(time / this.flights[0].dt);
    };
    plot.over.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      plot.over.setPointerCapture(event.pointerId);
      seek(event);
    });
    plot.over.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
      if (event.buttons & 1) seek(event);
    });
  }

  /** @param {Panel} panel */
  data(panel) {
    const [rows, dt] = [this.lastRow() + 1, this.flights[0].dt];
    const times = Array.from({ length: rows }, (_, k) => k * dt);
    return [times, ...panel.curves.map(({ values }) => {
      const found = values();
      return times.map((_, k) => found[k] ?? null);
    })];
  }

  lastRow() {
    return Math.max(1, ...this.flights.map((flight) => flight.knots - 1));
  }

  /** The flights have more rows now. */
  grow() {
    this.steps = new Map(this.flights[0].steps.map((step) => [step.row, step]));
    for (const { plot, panel } of this.panels) plot.setData(this.data(panel));
    this.drawLanes();
    this.seek(this.row);
  }

  /** @param {number} row */
  seek(row) {
    this.row = row;
    const k = Math.floor(row + 1e-6);
    for (const { plot, panel, playhead, values } of this.panels) {
      playhead.style.transform = `translateX(${plot.valToPos(row * this.flights[0].dt, "x")}px)`;
      const read = panel.curves.filter((curve) => curve.read);
      while (values.children.length < read.length) values.append(document.createElement("span"));
      read.forEach((curve, i) => {
        const value = plot.data[panel.curves.indexOf(curve) + 1][k];
        const span = /** @type {HTMLElement} */ (values.children[i]);
        span.style.setProperty("--swatch", curve.stroke);
        span.textContent = value === null || value === undefined ? "–" : `${signed(value, panel.digits)} ${panel.unit}`;
      });
    }
  }

  resize() {
    const width = this.container.clientWidth;
    if (width < 50) return;
    for (const { plot } of this.panels) plot.setSize({ width, height: plot.height });
    this.drawLanes();
    this.seek(this.row);
  }

  drawLanes() {
    const rows = this.lastRow();
    for (const { canvas, tone } of this.lanes) {
      const ratio = devicePixelRatio;
      canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      canvas.height = Math.round(11 * ratio);
      const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
      for (let k = 0; k < rows; k++) {
        const found = tone(k);
        if (found === null) continue;
        context.fillStyle = themeColor(LANE_COLORS[/** @type {keyof typeof LANE_COLORS} */ (found)]);
        const [left, right] = [Math.floor((k * canvas.width) / rows), Math.ceil(((k + 1) * canvas.width) / rows)];
        context.fillRect(left, 0, right - left, canvas.height);
      }
    }
  }
}

/**
 * @param {Flight[]} flights
 * @param {"reference" | "predicted"} against
 * @returns {[string, Panel[], {name: string, tone: (row: number) => string | null}[]?][]}
 */
function groups(flights, against) {
  const first = flights[0];
  const [ink, warn] = [themeColor("--ink"), themeColor("--warn")];
  const axisOf = (/** @type {(number[] | null)[]} */ positions, /** @type {number} */ axis) => () => positions.map((p) => p && p[axis]);
  /** The paper's curve, on the page's rows. */
  const paper = (/** @type {string} */ body, /** @type {number} */ axis, /** @type {string} */ color) =>
    first.paperSeries
      .filter((series) => series.body === body && series.axis === axis)
      .map((series) => ({ values: () => onRows(series, first.knots, first.dt), stroke: `${color}55`, width: 6 }));
  const position = (/** @type {number} */ axis) => ({ caption: `${AXES[axis]} (m)`, unit: "m", digits: 3, least: 0.1 });

  const endEffector = [0, 1, 2].map((axis) => ({
    ...position(axis),
    curves: [
      ...paper("end_effector", axis, onTheme(first.color)),
      { values: axisOf(first.reference, axis), stroke: ink, width: 1.2, dash: [2, 3] },
      { values: axisOf(first.predicted, axis), stroke: warn, width: 1.5, dash: [7, 4] },
      ...flights.map((flight) => ({ values: axisOf(flight.tip, axis), stroke: onTheme(flight.color), width: 1.8, read: true })),
    ],
  }));
  const quadrotor = [0, 1, 2].map((axis) => ({
    ...position(axis),
    curves: [
      ...paper("quadrotor", axis, onTheme(first.color)),
      { values: axisOf(first.predictedQuadrotor, axis), stroke: warn, width: 1.5, dash: [7, 4] },
      { values: axisOf(first.command, axis), stroke: ink, width: 1.1, steps: true },
      ...flights.map((flight) => ({ values: axisOf(flight.quadrotor, axis), stroke: onTheme(flight.color), width: 1.8, read: true })),
    ],
  }));
  /** @type {ReturnType<typeof groups>} */
  const all = [];
  if (first.hasPlan) {
    const name = against === "reference" ? "reference" : "prediction";
    const mean = first.published && first.judgedBy === against ? 50 * (first.published[0] + first.published[1]) : null;
    all.push([
      `Distance of the end effector to its ${name}`,
      [{
        caption: "cm", unit: "cm", digits: 1, height: 108, fromZero: true, least: 1,
        curves: [
          ...(mean === null ? [] : [{ values: () => Array(first.knots).fill(mean), stroke: `${onTheme(first.color)}77`, width: 4 }]),
          ...flights.map((flight) => ({ values: () => flight.errors[against], stroke: onTheme(flight.color), width: 1.8, read: true })),
        ],
      }],
      statusLanes(flights),
    ]);
  }
  all.push(["End effector", endEffector, first.hasPlan ? [] : statusLanes(flights)]);
  all.push(["Quadrotor and its command", quadrotor]);
  all.push(["Tilt", [{
    caption: "degrees", unit: "°", digits: 0, fromZero: true, least: 5,
    curves: flights.map((flight) => ({
      values: () => flight.attitude.map((_, k) => flight.tilt(k)), stroke: onTheme(flight.color), width: 1.8, read: true,
    })),
  }]]);
  if (first.configurations.length > 1 && first.configurations.some((c) => c[0] !== first.configurations[0][0] || c[1] !== first.configurations[0][1])) {
    const of = (/** @type {number} */ i, /** @type {string} */ caption, /** @type {string} */ unit) => ({
      caption, unit, digits: 2, least: 0.05,
      curves: [{ values: () => first.configurations.map((c) => c[i]), stroke: onTheme(first.color), width: 1.8, read: true }],
    });
    all.push(["Arm", [of(0, "length (m)", "m"), of(1, "pressure (kPa)", "kPa")]]);
  }
  const stepped = flights.filter((flight) => flight.steps.length > 0);
  if (stepped.length > 0) {
    all.push(["Controller", [{
      caption: "time of a step (ms)", unit: "ms", digits: 2, fromZero: true, least: 0.1,
      curves: stepped.map((flight) => ({
        values: () => {
          /** @type {Values} */ const times = [];
          for (const step of flight.steps) times[step.row] = step.ms;
          return times;
        },
        stroke: onTheme(flight.color), width: 1.6, read: true,
      })),
    }]]);
  }
  return all;
}

/** @param {Flight[]} flights */
function statusLanes([flight]) {
  /** @type {{name: string, tone: (row: number) => string | null}[]} */
  const lanes = [{
    name: "poses",
    tone: (/** @type {number} */ k) => {
      if (k >= flight.rows) return null;
      return flight.tip[k] && flight.quadrotor[k] ? "good" : "bad";
    },
  }];
  if (flight.steps.length > 0) {
    const tones = { optimal: "good", budget_spent: "warn", infeasible: "bad" };
    lanes.push({
      name: "solver",
      tone: (k) => tones[/** @type {keyof typeof tones} */ (flight.steps.find((step) => step.row === k)?.status ?? "")] ?? null,
    });
  }
  if (flight.states.length > 0) {
    lanes.push({ name: "state", tone: (k) => (flight.states[k] ? toneOf(flight.states[k]) : null) });
  }
  return lanes;
}

/** @param {string} state the supervisor's */
export function toneOf(state) {
  if (state === "flying") return "good";
  return state === "coasting" ? "warn" : "bad";
}

/**
 * A curve of uneven steps, interpolated on rows.
 * @param {{times: number[], values: number[]}} series
 * @param {number} rows
 * @param {number} dt
 */
function onRows({ times, values }, rows, dt) {
  /** @type {(number | null)[]} */
  const found = [];
  let i = 0;
  for (let k = 0; k < rows; k++) {
    const t = k * dt;
    while (i + 1 < times.length && times[i + 1] < t) i += 1;
    const inside = i + 1 < times.length && t >= times[i];
    const f = inside ? (t - times[i]) / (times[i + 1] - times[i]) : 0;
    found.push(inside ? values[i] + f * (values[i + 1] - values[i]) : null);
  }
  return found;
}

/**
 * @param {number} low
 * @param {number} high
 * @param {Panel} panel
 */
function padded(low, high, { fromZero, least = 0 }) {
  if (low === null || high === null || !Number.isFinite(low)) return [0, least || 1];
  if (fromZero) return [0, Math.max(1.08 * high, least)];
  const missing = Math.max(0, least - (high - low)) / 2;
  const margin = 0.07 * (high - low) + missing;
  return [low - margin, high + margin];
}

/**
 * @param {any} _
 * @param {number[]} splits
 */
function seconds(_, splits) {
  return splits.map((v, i) => (i === splits.length - 1 ? `${+v.toFixed(2)} s` : `${+v.toFixed(2)}`));
}

/**
 * @param {any} _
 * @param {number[]} splits
 */
function numbers(_, splits) {
  return splits.map((v) => `${+v.toFixed(3)}`.replace("-", "\u2212"));
}

/**
 * @param {number} value
 * @param {number} digits
 */
function signed(value, digits) {
  return value.toFixed(digits).replace("-", "\u2212");
}
