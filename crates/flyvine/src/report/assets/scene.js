"use strict";
// The 3-D scene of the replay: room, vehicle, paths. World frame ENU, z up, metres.
// It draws one experiment at one (fractional) row; what to draw and when is player.js's business.

const BACKGROUND = "#eef2f5";

class ReplayScene {
  constructor(canvas, onViewChanged) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setClearColor(BACKGROUND);
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
    this.following = false;

    this.addLights();
    this.addRoom();
    this.vehicle = buildQuadrotor();
    this.scene.add(this.vehicle);
    this.armMaterial = new THREE.MeshStandardMaterial({ roughness: 0.55 });
    this.arm = new THREE.Mesh(new THREE.BufferGeometry(), this.armMaterial);
    this.arm.castShadow = true;
    this.tipMaterial = new THREE.MeshStandardMaterial({ roughness: 0.35 });
    this.tip = new THREE.Mesh(new THREE.SphereGeometry(0.042, 24, 16), this.tipMaterial);
    this.tip.castShadow = true;
    this.command = buildCommandMarker();
    this.scene.add(this.arm, this.tip, this.command);

    this.layers = {
      reference: this.addLine({ color: "#1f2933", linewidth: 1.5 }),
      prediction: this.addLine({ color: "#8a5a00", linewidth: 1.6 }),
      // Pushed back, so that the trail on it stays clean.
      path: this.addLine({ linewidth: 2, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 40 }),
      trail: this.addLine({ linewidth: 4.5 }),
      error: this.addLine({ color: "#c62828", linewidth: 2 }),
    };
    this.layers.command = this.command;
    this.task = new THREE.Group();
    this.scene.add(this.task);
    this.setView("orbit");
  }

  addLights() {
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#c9d2d9", 2.2));
    const sun = new THREE.DirectionalLight("#ffffff", 1.9);
    sun.position.set(1.2, -1.6, 7);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    Object.assign(sun.shadow.camera, { left: -3.2, right: 3.2, top: 3.2, bottom: -3.2, near: 1, far: 12 });
    this.scene.add(sun);
  }

  // Ground with lines every 0.5 m (bolder every metre), axis arrows and metre marks.
  addRoom() {
    const reach = 2.5;
    const shadow = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * reach, 2 * reach),
      new THREE.ShadowMaterial({ opacity: 0.22 }),
    );
    shadow.receiveShadow = true;
    shadow.position.z = 0.001;
    this.scene.add(shadow);
    const lines = (isDrawn, color) => {
      const points = [];
      for (let i = -2 * reach; i <= 2 * reach; i++) {
        if (!isDrawn(i)) continue;
        points.push(i / 2, -reach, 0, i / 2, reach, 0, -reach, i / 2, 0, reach, i / 2, 0);
      }
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
      this.scene.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color })));
    };
    lines((i) => i % 2 !== 0, "#dde4e9");
    lines((i) => i % 2 === 0, "#bcc8d0");
    const axes = [
      ["x east", [1, 0, 0], "#b23a48"],
      ["y north", [0, 1, 0], "#2f7d4f"],
      ["z up", [0, 0, 1], "#2d5fa8"],
    ];
    const origin = new THREE.Group();
    for (const [name, direction, color] of axes) {
      const end = direction.map((v) => 0.3 * v);
      const line = this.makeLine({ color, linewidth: 3 });
      writeLine(line, [[0, 0, 0], end]);
      origin.add(line);
      const label = buildLabel(name, color, 0.1);
      label.position.set(...direction.map((v) => 0.42 * v));
      origin.add(label);
    }
    origin.position.set(0, 0, 0.004);
    this.scene.add(origin);
    for (const metre of [-2, -1, 0, 1, 2]) {
      const text = `${metre} m`.replace("-", "\u2212");
      const alongX = buildLabel(text, "#6b7780", 0.12);
      alongX.position.set(metre, reach + 0.14, 0);
      const alongY = buildLabel(text, "#6b7780", 0.12);
      alongY.position.set(reach + 0.1, metre, 0);
      this.scene.add(alongX, alongY);
    }
  }

  makeLine(options) {
    const line = new THREE.Line2(new THREE.LineGeometry(), new THREE.LineMaterial(options));
    line.frustumCulled = false;
    return line;
  }

  addLine(options) {
    const line = this.makeLine(options);
    this.scene.add(line);
    return line;
  }

  // Takes an experiment as decoded by player.js.
  show(experiment) {
    this.experiment = experiment;
    this.armMaterial.color.set(experiment.color).lerp(new THREE.Color("#ffffff"), 0.45);
    this.tipMaterial.color.set(experiment.color);
    this.layers.path.material.color.set(experiment.color).lerp(new THREE.Color(BACKGROUND), 0.65);
    this.layers.trail.material.color.set(experiment.color);
    writeLine(this.layers.reference, experiment.reference);
    writeLine(this.layers.prediction, experiment.predicted);
    writeLine(this.layers.path, experiment.tip.filter(Boolean));
    this.task.clear();
    if (experiment.target) this.addTarget(experiment);
  }

  addTarget({ target, limits }) {
    const ring = new THREE.Mesh(
      new THREE.TorusGeometry(0.085, 0.012, 12, 48),
      new THREE.MeshStandardMaterial({ color: "#1f2933", roughness: 0.4 }),
    );
    ring.rotation.x = Math.PI / 2; // into the xz plane
    ring.position.set(target[0], 0, target[1]);
    ring.castShadow = true;
    this.task.add(ring);
    const [x, z] = limits;
    if (x !== null) this.addLimit([1.0, 2.2], (m) => { m.rotation.y = Math.PI / 2; m.position.set(x, 0, 1.1); });
    if (z !== null) this.addLimit([2.6, 1.0], (m) => m.position.set((x ?? 1) - 1.3, 0, z));
  }

  // A translucent wall with a dashed edge; `place` turns it from the xy plane to where it stands.
  addLimit([width, height], place) {
    const plane = new THREE.PlaneGeometry(width, height);
    const wall = new THREE.Mesh(plane, new THREE.MeshBasicMaterial({
      color: "#6b7780", transparent: true, opacity: 0.12, side: THREE.DoubleSide, depthWrite: false,
    }));
    const edge = new THREE.LineSegments(
      new THREE.EdgesGeometry(plane),
      new THREE.LineDashedMaterial({ color: "#6b7780", dashSize: 0.06, gapSize: 0.04 }),
    );
    edge.computeLineDistances();
    wall.add(edge);
    place(wall);
    this.task.add(wall);
  }

  // Poses the vehicle at a fractional row; positions between rows are interpolated.
  update(row) {
    const e = this.experiment;
    const last = e.rows - 1;
    const k = Math.min(Math.floor(row), last);
    const next = Math.min(k + 1, last);
    const f = row - k;
    const quadrotor = between(e.quadrotor, k, next, f);
    const tip = between(e.tip, k, next, f);
    const attitude = e.attitude[k] && e.attitude[next]
      ? new THREE.Quaternion(...e.attitude[k]).slerp(new THREE.Quaternion(...e.attitude[next]), f)
      : null;
    this.vehicle.visible = Boolean(quadrotor && attitude);
    this.tip.visible = Boolean(tip);
    this.arm.visible = this.vehicle.visible && this.tip.visible;
    if (this.vehicle.visible) {
      if (this.following) this.follow(new THREE.Vector3(...quadrotor));
      this.vehicle.position.set(...quadrotor);
      this.vehicle.quaternion.copy(attitude);
      this.vehicle.userData.spin(row);
    }
    if (tip) this.tip.position.set(...tip);
    if (this.arm.visible) this.bendArm(quadrotor, attitude, tip, k, next, f);
    this.command.position.set(...e.command[k]);

    const length = 45; // rows of trail, 2.25 s
    const trail = e.tip.slice(Math.max(0, k - length), k + 1).filter(Boolean);
    if (tip) trail.push(tip);
    writeLine(this.layers.trail, trail);
    const followed = e.followed === "reference" ? e.reference : e.predicted;
    writeLine(this.layers.error, tip ? [tip, between(followed, k, next, f)] : []);
  }

  // The arm's centre line: as the vehicle reported it, or else a cantilever's: leaving along the body's
  // down axis, without curvature at the free end.
  bendArm(quadrotor, attitude, tip, k, next, f) {
    const { arm } = this.experiment;
    let curve;
    if (arm) {
      const nodes = arm[k].map((node, i) => new THREE.Vector3(...mix(node, arm[next][i], f)));
      curve = new THREE.CatmullRomCurve3(nodes);
    } else {
      const base = new THREE.Vector3(...quadrotor);
      const end = new THREE.Vector3(...tip);
      const down = new THREE.Vector3(0, 0, -1).applyQuaternion(attitude);
      const first = base.clone().addScaledVector(down, base.distanceTo(end) / 3);
      const second = first.clone().add(end).multiplyScalar(0.5);
      curve = new THREE.CubicBezierCurve3(base, first, second, end);
    }
    this.arm.geometry.dispose();
    this.arm.geometry = new THREE.TubeGeometry(curve, 32, 0.024, 14);
  }

  setLayer(name, visible) {
    this.layers[name].visible = visible;
    if (name === "trail") this.layers.path.visible = visible;
  }

  setView(name) {
    const views = {
      orbit: [[2.3, -3.9, 2.35], [0, 0, 0.78]],
      side: [[0.3, -5.0, 1.15], [0.3, 0, 1.05]],
      top: [[0, -0.01, 6.4], [0, 0, 0.8]],
    };
    this.following = name === "follow";
    if (this.following) {
      const { x, y, z } = this.vehicle.position;
      this.camera.position.set(x + 1.3, y - 2.2, z + 0.6);
      this.controls.target.set(x, y, z - 0.4);
    } else {
      const [position, target] = views[name];
      this.camera.position.set(...position);
      this.controls.target.set(...target);
    }
    this.controls.update();
  }

  // Moves the camera with the vehicle.
  follow(position) {
    const step = position.clone().sub(this.vehicle.position);
    this.camera.position.add(step);
    this.controls.target.add(step);
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
}

function mix(a, b, f) {
  return a.map((v, i) => v + f * (b[i] - v));
}

// The position between two rows, or whichever of them was seen, or null.
function between(positions, k, next, f) {
  const [a, b] = [positions[k], positions[next]];
  return a && b ? mix(a, b, f) : a || b;
}

// Fills a Line2, replacing its buffers only when they are too short.
function writeLine(line, points) {
  const segments = Math.max(points.length - 1, 0);
  const buffer = line.geometry.attributes.instanceStart;
  if (!buffer || buffer.count < segments) {
    const spare = Array(Math.max(64 - points.length, 0)).fill(points[points.length - 1] || [0, 0, 0]);
    line.geometry.dispose();
    line.geometry = new THREE.LineGeometry();
    line.geometry.setPositions([...points, ...spare].flat());
  } else {
    for (let i = 0; i < segments; i++) buffer.data.array.set([...points[i], ...points[i + 1]], 6 * i);
    buffer.data.needsUpdate = true;
  }
  line.geometry.instanceCount = segments;
}

// An X quadrotor, 0.36 m from motor to motor; the orange arms point forward (+x of the body).
function buildQuadrotor() {
  const group = new THREE.Group();
  const dark = new THREE.MeshStandardMaterial({ color: "#2b343b", roughness: 0.6 });
  const front = new THREE.MeshStandardMaterial({ color: "#e8833a", roughness: 0.6 });
  const disc = new THREE.MeshStandardMaterial({
    color: "#5b6770", transparent: true, opacity: 0.25, side: THREE.DoubleSide, depthWrite: false,
  });
  const body = new THREE.Mesh(new THREE.BoxGeometry(0.13, 0.085, 0.05), dark);
  const lid = new THREE.Mesh(new THREE.BoxGeometry(0.08, 0.06, 0.022), front);
  lid.position.z = 0.035;
  group.add(body, lid);
  const blades = [];
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
  group.traverse((part) => { part.castShadow = part.isMesh && part.material !== disc; });
  group.userData.spin = (row) => blades.forEach((b) => { b.rotation.z = 2.1 * row * b.userData.turn; });
  return group;
}

function buildCommandMarker() {
  const marker = new THREE.LineSegments(
    new THREE.EdgesGeometry(new THREE.OctahedronGeometry(0.075)),
    new THREE.LineBasicMaterial({ color: "#1f2933" }),
  );
  return marker;
}

// Text that faces the camera, `height` metres tall.
function buildLabel(text, color, height) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
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
  const material = new THREE.SpriteMaterial({ map, depthTest: false });
  const label = new THREE.Sprite(material);
  label.scale.set((height * canvas.width) / canvas.height, height, 1);
  return label;
}
