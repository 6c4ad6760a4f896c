// @ts-check
// What stands in a scene: quadrotor, arm, room, labels, lines; of report.html, which has this file in its module script,
// and of the page of `flyvine view`, which imports it. World frame ENU, z up, metres.

/** @type {any} three.js, a classic script before */
export const THREE = /** @type {any} */ (globalThis).THREE;

/** An X quadrotor, 0.36 m from motor to motor; the orange arms point forward (+x of the body). */
export function buildQuadrotor() {
  const group = new THREE.Group();
  const dark = new THREE.MeshStandardMaterial({ color: "#39444d", roughness: 0.6 });
  const front = new THREE.MeshStandardMaterial({ color: "#e8833a", roughness: 0.6 });
  const disc = new THREE.MeshStandardMaterial({
    color: "#7d8a94", transparent: true, opacity: 0.28, side: THREE.DoubleSide, depthWrite: false,
  });
  const body = new THREE.Mesh(new THREE.BoxGeometry(0.13, 0.085, 0.05), dark);
  const lid = new THREE.Mesh(new THREE.BoxGeometry(0.08, 0.06, 0.022), front);
  lid.position.z = 0.035;
  group.add(body, lid);
  /** @type {any[]} */ const blades = [];
  for (const [sx, sy] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const [x, y] = [0.128 * sx, 0.128 * sy];
    const beam = new THREE.Mesh(new THREE.CylinderGeometry(0.0085, 0.011, 0.181, 10), sx > 0 ? front : dark);
    beam.rotation.z = Math.atan2(y, x) - Math.PI / 2;
    beam.position.set(x / 2, y / 2, 0);
    const motor = new THREE.Mesh(new THREE.CylinderGeometry(0.016, 0.018, 0.036, 16), dark);
    motor.rotation.x = Math.PI / 2;
    motor.position.set(x, y, 0.012);
    const rotor = new THREE.Mesh(new THREE.CircleGeometry(0.088, 36), disc);
    rotor.position.set(x, y, 0.036);
    const blade = new THREE.Mesh(new THREE.BoxGeometry(0.17, 0.013, 0.003), dark);
    blade.position.set(x, y, 0.034);
    blade.userData.turn = sx * sy;
    blades.push(blade);
    group.add(beam, motor, rotor, blade);
  }
  group.traverse((/** @type {any} */ part) => { part.castShadow = part.isMesh && part.material !== disc; });
  group.userData.spin = (/** @type {number} */ row) => blades.forEach((b) => { b.rotation.z = 2.1 * row * b.userData.turn; });
  return group;
}

/**
 * Ground with lines every 0.5 m (bolder every metre), axis arrows and metre marks.
 * @param {{minor: string, major: string, text: string, axes: string[]}} colors
 */
export function buildRoom(colors) {
  const room = new THREE.Group();
  const reach = 2.5;
  const shadow = new THREE.Mesh(
    new THREE.PlaneGeometry(2 * reach, 2 * reach),
    new THREE.ShadowMaterial({ opacity: 0.22 }),
  );
  shadow.receiveShadow = true;
  shadow.position.z = 0.001;
  room.add(shadow);
  for (const [parity, color] of /** @type {[number, string][]} */ ([[1, colors.minor], [0, colors.major]])) {
    const points = [];
    for (let i = -2 * reach; i <= 2 * reach; i++) {
      if (Math.abs(i % 2) !== parity) continue;
      points.push(i / 2, -reach, 0, i / 2, reach, 0, -reach, i / 2, 0, reach, i / 2, 0);
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    room.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color })));
  }
  /** @type {[string, number[]][]} */
  const axes = [["x east", [1, 0, 0]], ["y north", [0, 1, 0]], ["z up", [0, 0, 1]]];
  axes.forEach(([name, direction], i) => {
    const line = makeLine({ color: colors.axes[i], linewidth: 3 });
    writeLine(line, [[0, 0, 0.004], direction.map((v, axis) => 0.3 * v + (axis === 2 ? 0.004 : 0))]);
    const label = buildLabel(name, colors.axes[i], 0.11);
    label.position.set(...direction.map((v) => 0.42 * v));
    room.add(line, label);
  });
  for (const metre of [-2, -1, 0, 1, 2]) {
    const text = `${metre} m`.replace("-", "\u2212");
    const [alongX, alongY] = [buildLabel(text, colors.text, 0.12), buildLabel(text, colors.text, 0.12)];
    alongX.position.set(metre, -reach - 0.14, 0);
    alongY.position.set(reach + 0.16, metre, 0);
    room.add(alongX, alongY);
  }
  return room;
}

/**
 * Where a swing's end effector shall be, and what its quadrotor shall not leave.
 * @param {[number, number]} target x and z, m
 * @param {[number | null, number | null]} limits largest quadrotor x and z, m
 * @param {string} color
 */
export function buildTarget(target, limits, color) {
  const group = new THREE.Group();
  const ring = new THREE.Mesh(
    new THREE.TorusGeometry(0.085, 0.012, 12, 48),
    new THREE.MeshStandardMaterial({ color, roughness: 0.4 }),
  );
  ring.rotation.x = Math.PI / 2; // into the xz plane
  ring.position.set(target[0], 0, target[1]);
  ring.castShadow = true;
  group.add(ring);
  /** A translucent wall; `place` turns it from the xy plane to where it stands. */
  const addLimit = (/** @type {number} */ width, /** @type {number} */ height, /** @type {(m: any) => void} */ place) => {
    const plane = new THREE.PlaneGeometry(width, height);
    const wall = new THREE.Mesh(plane, new THREE.MeshBasicMaterial({
      color, transparent: true, opacity: 0.1, side: THREE.DoubleSide, depthWrite: false,
    }));
    const edge = new THREE.LineSegments(
      new THREE.EdgesGeometry(plane),
      new THREE.LineDashedMaterial({ color, dashSize: 0.06, gapSize: 0.04 }),
    );
    edge.computeLineDistances();
    wall.add(edge);
    place(wall);
    group.add(wall);
  };
  const [x, z] = limits;
  if (x !== null) addLimit(1.0, 2.2, (wall) => { wall.rotation.y = Math.PI / 2; wall.position.set(x, 0, 1.1); });
  if (z !== null) addLimit(2.6, 1.0, (wall) => wall.position.set((x ?? 1) - 1.3, 0, z));
  return group;
}

/** @param {number} shadowPixels size of the sun's shadow map */
export function buildLights(shadowPixels) {
  const lights = new THREE.Group();
  const sun = new THREE.DirectionalLight("#ffffff", 1.9);
  sun.position.set(1.2, -1.6, 7);
  sun.castShadow = true;
  sun.shadow.mapSize.set(shadowPixels, shadowPixels);
  Object.assign(sun.shadow.camera, { left: -3.2, right: 3.2, top: 3.2, bottom: -3.2, near: 1, far: 12 });
  lights.add(new THREE.HemisphereLight("#ffffff", "#c9d2d9", 2.2), sun);
  return lights;
}

/**
 * The arm's centre line: as the vehicle reported it, or else a cantilever's: leaving along the body's down axis, without
 * curvature at the free end.
 * @param {number[]} quadrotor
 * @param {any} attitude
 * @param {number[]} tip
 * @param {number[][] | null} nodes from the clamp to the tip
 */
export function armCurve(quadrotor, attitude, tip, nodes) {
  const base = new THREE.Vector3(...quadrotor);
  // The first node is the arm's clamp, below the body that holds it.
  if (nodes) return new THREE.CatmullRomCurve3([base, ...nodes.map((node) => new THREE.Vector3(...node))]);
  const end = new THREE.Vector3(...tip);
  const down = new THREE.Vector3(0, 0, -1).applyQuaternion(attitude);
  const first = base.clone().addScaledVector(down, base.distanceTo(end) / 3);
  const second = first.clone().add(end).multiplyScalar(0.5);
  return new THREE.CubicBezierCurve3(base, first, second, end);
}

/** @param {string} color */
export function buildCommandMarker(color) {
  return new THREE.LineSegments(
    new THREE.EdgesGeometry(new THREE.OctahedronGeometry(0.075)),
    new THREE.LineBasicMaterial({ color }),
  );
}

/** @param {object} options of a LineMaterial; `linewidth` in pixels */
export function makeLine(options) {
  const line = new THREE.Line2(new THREE.LineGeometry(), new THREE.LineMaterial(options));
  line.frustumCulled = false;
  return line;
}

/**
 * Fills a line, replacing its buffers only when they are too short.
 * @param {any} line
 * @param {number[][]} points
 */
export function writeLine(line, points) {
  const segments = Math.max(points.length - 1, 0);
  const buffer = line.geometry.attributes.instanceStart;
  if (!buffer || buffer.count < segments) {
    // Room to grow: live paths get longer row by row.
    const spare = Array(Math.max(64, points.length)).fill(points[points.length - 1] ?? [0, 0, 0]);
    line.geometry.dispose();
    line.geometry = new THREE.LineGeometry();
    line.geometry.setPositions([...points, ...spare].flat());
  } else {
    for (let i = 0; i < segments; i++) buffer.data.array.set([...points[i], ...points[i + 1]], 6 * i);
    buffer.data.needsUpdate = true;
  }
  line.geometry.instanceCount = segments;
}

/**
 * Text that faces the camera, `height` metres tall.
 * @param {string} text
 * @param {string} color
 * @param {number} height
 */
function buildLabel(text, color, height) {
  const canvas = document.createElement("canvas");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const font = "600 44px system-ui, sans-serif";
  context.font = font;
  canvas.width = Math.ceil(context.measureText(text).width) + 12;
  canvas.height = 60;
  context.font = font; // resizing resets it
  context.fillStyle = color;
  context.textBaseline = "middle";
  context.fillText(text, 6, 32);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const label = new THREE.Sprite(new THREE.SpriteMaterial({ map, depthTest: false }));
  label.scale.set((height * canvas.width) / canvas.height, height, 1);
  return label;
}

/**
 * @param {number[]} a
 * @param {number[]} b
 * @param {number} f
 */
export function mix(a, b, f) {
  return a.map((v, i) => v + f * (b[i] - v));
}

/**
 * The position between two rows, or whichever of them was seen, or null.
 * @param {(number[] | null)[]} positions
 * @param {number} k
 * @param {number} next
 * @param {number} f
 * @returns {any}
 */
export function between(positions, k, next, f) {
  const [a, b] = [positions[k], positions[next]];
  return a && b ? mix(a, b, f) : a || b || null;
}
