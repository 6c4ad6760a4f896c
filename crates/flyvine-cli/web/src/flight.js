// @ts-check
// One flight as the page draws it. World frame ENU, z up, metres; rows are the flight's samples, dt apart.

/**
 * @typedef {[number, number, number]} Position
 * @typedef {{body: string, points: Position[]}} PaperPath  a measured path of the paper, in space
 * @typedef {{body: string, axis: number, times: number[], values: number[]}} PaperSeries  over time
 * @typedef {{row: number, ms: number, status: string}} Step  what the controller reported
 */

export const AXES = ["x", "y", "z"];

/** One flight, decoded; see `ReplayTrack` in the library for the wire format. */
export class Flight {
  /**
   * @param {any} raw an entry of data.json
   * @param {number} dt
   */
  constructor(raw, dt) {
    this.dt = dt;
    /** @type {string} */ this.name = raw.name;
    const title = raw.title.replace(", period ", " ").replace(/(\d) s\b/, "$1\u00a0s");
    /** @type {string} */ this.title = raw.source ? `${raw.source}: ${title}` : title;
    /** @type {string} */ this.kind = raw.kind;
    /** @type {string} */ this.baseColor = raw.color;
    /** @type {string} colour while shown, set by the page */ this.color = raw.color;
    /** @type {(Position | null)[]} */ this.quadrotor = positions(raw.quadrotor);
    /** @type {([number, number, number, number] | null)[]} [x, y, z, w] */
    this.attitude = split(raw.attitude, 4, 1e-4).map((q) => q && [q[1], q[2], q[3], q[0]]);
    /** @type {(Position | null)[]} */ this.tip = positions(raw.tip);
    /** @type {(Position | null)[]} */ this.command = positions(raw.command);
    /** @type {Position[]} */ this.reference = positions(raw.reference);
    /** @type {Position[]} */ this.predicted = positions(raw.predicted);
    /** @type {Position[]} */ this.predictedQuadrotor = positions(raw.predictedQuadrotor);
    /** @type {Position[][] | null} */ this.arm = raw.arm ? raw.arm.map(positions) : null;
    /** @type {[number, number][]} */ this.configurations = raw.configurations;
    /** @type {[number, number] | null} */ this.target = raw.target ?? null;
    /** @type {number | null} */ this.targetKnot = raw.targetKnot ?? null;
    /** @type {[number | null, number | null]} */ this.limits = raw.limits;
    /** @type {PaperPath[]} */ this.paperPaths = raw.paperPaths;
    /** @type {PaperSeries[]} */ this.paperSeries = raw.paperSeries;
    /** @type {Step[]} */ this.steps = raw.steps;
    /** @type {[number, number] | null} the paper's mean error, m */ this.published = raw.published;
    /** @type {string | null} */ this.remark = raw.remark;
    /** @type {string[]} the supervisor's state per row; only live */ this.states = [];
    /** @type {{reference: (number | null)[], predicted: (number | null)[]}} cm */
    this.errors = { reference: [], predicted: [] };
    for (let k = 0; k < this.rows; k++) this.measure(k);
  }

  get rows() {
    return this.command.length;
  }

  /** Rows of the flight or knots of its plan, whichever are more. */
  get knots() {
    return Math.max(this.rows, this.reference.length);
  }

  get hasPlan() {
    return this.reference.length > 0;
  }

  /** What its error is judged against, as the paper does: swings and deployments by the prediction. */
  get judgedBy() {
    return this.kind === "swing" || this.kind === "deploy" ? "predicted" : "reference";
  }

  /** @param {number} k */
  measure(k) {
    for (const against of /** @type {const} */ (["reference", "predicted"])) {
      const [tip, wanted] = [this.tip[k], this[against][k]];
      this.errors[against][k] = tip && wanted ? 100 * distance(tip, wanted) : null;
    }
  }

  /**
   * Appends (or replaces) one row that was flown just now.
   * @param {any} row a row of the live feed
   */
  append(row) {
    const k = row.row;
    this.quadrotor[k] = row.quadrotor;
    this.attitude[k] = row.attitude && [row.attitude[1], row.attitude[2], row.attitude[3], row.attitude[0]];
    this.tip[k] = row.tip;
    this.configurations[k] = row.configuration;
    this.states[k] = row.state;
    if (row.arm) (this.arm ??= [])[k] = row.arm;
    if (row.step) this.steps.push({ row: k, ms: row.step.ms, status: row.step.status });
    this.command[k] = row.command;
    this.measure(k);
  }

  /** @param {number} k */
  configuration(k) {
    return this.configurations.length === 1 ? this.configurations[0] : this.configurations[k];
  }

  /**
   * Angle between the body's z axis and the vertical: cos = 1 − 2 (q_x² + q_y²).
   * @param {number} k
   */
  tilt(k) {
    const q = this.attitude[k];
    return q ? (180 / Math.PI) * Math.acos(Math.min(1, Math.max(-1, 1 - 2 * (q[0] ** 2 + q[1] ** 2)))) : null;
  }

  /**
   * Mean and largest error so far, cm.
   * @param {"reference" | "predicted"} against
   */
  summary(against) {
    let [sum, largest, seen] = [0, 0, 0];
    for (const error of this.errors[against]) {
      if (error === null || error === undefined) continue;
      sum += error;
      largest = Math.max(largest, error);
      seen += 1;
    }
    return seen ? { mean: sum / seen, largest } : null;
  }
}

/**
 * @param {number[]} a
 * @param {number[]} b
 */
export function distance(a, b) {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/**
 * Rows of `size` integers, scaled; rows that were not seen are null.
 * @param {(number | null)[] | undefined} flat
 * @param {number} size
 * @param {number} scale
 * @returns {any[]}
 */
function split(flat, size, scale) {
  const items = [];
  for (let i = 0; flat && i < flat.length; i += size) {
    items.push(flat[i] === null ? null : flat.slice(i, i + size).map((v) => /** @type {number} */ (v) * scale));
  }
  return items;
}

/** @param {(number | null)[] | undefined} flat */
function positions(flat) {
  return split(flat, 3, 1e-4);
}
