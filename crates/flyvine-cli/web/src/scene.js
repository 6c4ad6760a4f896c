// @ts-check
// The 3-D scene: room, vehicles, paths. It draws the shown flights at one (fractional) row; what to show and when is
// the page's business.

import {
  THREE, armCurve, between, buildCommandMarker, buildLights, buildQuadrotor, buildRoom, buildTarget, makeLine, mix, writeLine,
} from "./models.js";
import { isDark, onTheme, themeColor } from "./theme.js";

/** @typedef {import("./flight.js").Flight} Flight */

const VIEWS = {
  orbit: [[2.5, -4.2, 2.5], [0, 0, 0.78]],
  side: [[0.3, -5.6, 1.15], [0.3, 0, 1.05]],
  top: [[0, -0.01, 6.8], [0, 0, 0.8]],
};
const TRAIL_ROWS = 45; // 2.25 s

/** What can be switched off, in the order of the boxes. */
export const LAYERS = /** @type {const} */ (["reference", "prediction", "paper", "path", "command", "error"]);

export class Scene {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {() => void} onViewChanged
   */
  constructor(canvas, onViewChanged) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(38, 1, 0.05, 60);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 0.55 * Math.PI;
    this.controls.minDistance = 0.6;
    this.controls.maxDistance = 14;
    this.controls.addEventListener("change", onViewChanged);
    /** @type {Record<string, boolean>} */ this.visible = {};
    for (const layer of LAYERS) this.visible[layer] = true;
    /** @type {Actor[]} */ this.actors = [];
    this.background = "";
    this.view = "orbit";
    this.resize();
    this.scene.add(buildLights(1024));
    this.setTheme();
    this.setView("orbit");
  }

  setTheme() {
    const dark = isDark();
    this.background = dark ? "#141b21" : "#eef2f5";
    this.renderer.setClearColor(this.background);
    if (this.room) this.scene.remove(this.room);
    this.room = buildRoom(dark
      ? { minor: "#212b33", major: "#34424c", text: "#93a2ad", axes: ["#e27b89", "#6cc08c", "#7aa7ea"] }
      : { minor: "#dde4e9", major: "#bcc8d0", text: "#6b7780", axes: ["#b23a48", "#2f7d4f", "#2d5fa8"] });
    this.scene.add(this.room);
    this.show(this.actors.map((actor) => actor.flight));
  }

  /**
   * The first one is the one whose plan is drawn.
   * @param {Flight[]} flights
   */
  show(flights) {
    for (const actor of this.actors) this.scene.remove(actor.group);
    this.actors = flights.map((flight, i) => new Actor(flight, i === 0, this.background));
    for (const actor of this.actors) this.scene.add(actor.group);
    this.applyLayers();
  }

  /** The flight that the page shows has more rows now. */
  grow() {
    for (const actor of this.actors) actor.drawPath();
  }

  /** @param {number} row */
  update(row) {
    for (const actor of this.actors) {
      const before = actor.vehicle.position.clone();
      actor.update(row);
      if (actor.isFirst && this.view === "follow") {
        const step = actor.vehicle.position.clone().sub(before);
        this.camera.position.add(step);
        this.controls.target.add(step);
        this.controls.update();
      }
    }
  }

  /**
   * @param {string} layer
   * @param {boolean} visible
   */
  setLayer(layer, visible) {
    this.visible[layer] = visible;
    this.applyLayers();
  }

  applyLayers() {
    for (const actor of this.actors) {
      for (const layer of LAYERS) actor.layers[layer].visible = this.visible[layer];
    }
  }

  /** @param {string} name */
  setView(name) {
    this.view = name;
    if (name === "follow") {
      const { x, y, z } = this.actors[0]?.vehicle.position ?? { x: 0, y: 0, z: 1.5 };
      this.camera.position.set(x + 1.3, y - 2.4, z + 0.6);
      this.controls.target.set(x, y, z - 0.4);
    } else {
      const [position, target] = VIEWS[/** @type {keyof typeof VIEWS} */ (name)];
      this.controls.target.set(...target);
      // A tall window sees less to the sides: step back.
      const back = Math.max(1, 0.95 / this.camera.aspect);
      this.camera.position.set(...position.map((v, i) => target[i] + back * (v - target[i])));
    }
    this.controls.update();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
  }

  render() {
    this.renderer.render(this.scene, this.camera);
  }

  /** For machines without a graphics card: no shadows, fewer pixels. */
  simplify() {
    this.renderer.shadowMap.enabled = false;
    this.scene.traverse((/** @type {any} */ part) => {
      if (part.isLight) part.castShadow = false;
      if (part.material) part.material.needsUpdate = true;
    });
    this.renderer.setPixelRatio(0.6);
    this.resize();
  }
}

/** One flight in the scene. */
class Actor {
  /**
   * @param {Flight} flight
   * @param {boolean} isFirst whether its plan and the paper's curves are drawn
   * @param {string} background
   */
  constructor(flight, isFirst, background) {
    this.flight = flight;
    this.isFirst = isFirst;
    const color = onTheme(flight.color);
    const ink = themeColor("--ink");
    const faint = (/** @type {string} */ c, /** @type {number} */ by) => new THREE.Color(c).lerp(new THREE.Color(background), by);
    this.vehicle = buildQuadrotor();
    this.arm = new THREE.Mesh(
      new THREE.BufferGeometry(),
      new THREE.MeshStandardMaterial({ color: new THREE.Color(color).lerp(new THREE.Color("#ffffff"), 0.4), roughness: 0.55 }),
    );
    this.arm.castShadow = true;
    this.tip = new THREE.Mesh(
      new THREE.SphereGeometry(0.042, 24, 16),
      new THREE.MeshStandardMaterial({ color, roughness: 0.35 }),
    );
    this.tip.castShadow = true;
    // Pushed back, so that the trail on it stays clean.
    this.path = makeLine({ color: faint(color, 0.45), linewidth: 2, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 40 });
    this.trail = makeLine({ color, linewidth: 4.5 });
    this.error = makeLine({ color: themeColor("--bad"), linewidth: 2 });
    this.reference = makeLine({ color: ink, linewidth: 1.5 });
    this.prediction = makeLine({ color: themeColor("--warn"), linewidth: 1.8 });
    this.command = buildCommandMarker(ink);
    const paths = new THREE.Group();
    paths.add(this.path, this.trail);
    const paper = new THREE.Group();
    if (isFirst) {
      for (const { body, points } of flight.paperPaths) {
        const curve = makeLine({ color: faint(body === "end_effector" ? color : "#808c95", 0.55), linewidth: 6, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 80 });
        writeLine(curve, points);
        paper.add(curve);
      }
      writeLine(this.reference, flight.reference);
      writeLine(this.prediction, flight.predicted);
    }
    /** @type {Record<string, any>} */
    this.layers = {
      reference: this.reference, prediction: this.prediction, paper, path: paths, command: this.command, error: this.error,
    };
    this.group = new THREE.Group();
    this.group.add(this.vehicle, this.arm, this.tip, ...Object.values(this.layers));
    if (isFirst && flight.target) this.group.add(buildTarget(flight.target, flight.limits, ink));
    this.drawPath();
  }

  drawPath() {
    writeLine(this.path, this.flight.tip.filter(isSeen));
  }

  /**
   * Poses the vehicle at a fractional row; positions between rows are interpolated.
   * @param {number} row
   */
  update(row) {
    const flight = this.flight;
    const last = flight.rows - 1;
    this.group.visible = last >= 0;
    if (last < 0) return;
    const k = Math.min(Math.floor(row), last);
    const next = Math.min(k + 1, last);
    const f = Math.min(Math.max(row - k, 0), 1);
    const quadrotor = between(flight.quadrotor, k, next, f);
    const tip = between(flight.tip, k, next, f);
    const [before, after] = [flight.attitude[k], flight.attitude[next]];
    const attitude = before && after
      ? new THREE.Quaternion(...before).slerp(new THREE.Quaternion(...after), f)
      : null;
    this.vehicle.visible = Boolean(quadrotor && attitude);
    this.tip.visible = Boolean(tip);
    this.arm.visible = this.vehicle.visible && this.tip.visible;
    if (quadrotor && attitude) {
      this.vehicle.position.set(...quadrotor);
      this.vehicle.quaternion.copy(attitude);
      this.vehicle.userData.spin(row);
    }
    if (tip) this.tip.position.set(...tip);
    if (quadrotor && attitude && tip) this.bendArm(quadrotor, attitude, tip, k, next, f);
    this.command.position.set(.../** @type {number[]} */ (flight.command[k] ?? [0, 0, -10]));

    const trail = flight.tip.slice(Math.max(0, k - TRAIL_ROWS), k + 1).filter(isSeen);
    if (tip) trail.push(tip);
    writeLine(this.trail, trail);
    const wanted = between(flight[flight.judgedBy], k, next, f);
    writeLine(this.error, tip && wanted && this.isFirst ? [tip, wanted] : []);
  }

  /**
   * @param {number[]} quadrotor
   * @param {any} attitude
   * @param {number[]} tip
   * @param {number} k
   * @param {number} next
   * @param {number} f
   */
  bendArm(quadrotor, attitude, tip, k, next, f) {
    const [before, after] = [this.flight.arm?.[k], this.flight.arm?.[next]];
    const nodes = before && after ? before.map((node, i) => mix(node, after[i], f)) : null;
    this.arm.geometry.dispose();
    this.arm.geometry = new THREE.TubeGeometry(armCurve(quadrotor, attitude, tip, nodes), 28, 0.024, 12);
  }
}

/** @type {(position: any) => position is import("./flight.js").Position} */
function isSeen(position) {
  return Boolean(position);
}
