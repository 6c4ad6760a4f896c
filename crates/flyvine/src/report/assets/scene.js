// The 3-D scene of the replay: models.js's room and vehicle, and the paths. It draws one experiment at one (fractional)
// row; what to draw and when is player.js's business.

const BACKGROUND = "#eef2f5";
const INK = "#1f2933";
const ROOM = { minor: "#dde4e9", major: "#bcc8d0", text: "#6b7780", axes: ["#b23a48", "#2f7d4f", "#2d5fa8"] };

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

    this.scene.add(buildLights(2048), buildRoom(ROOM));
    this.vehicle = buildQuadrotor();
    this.scene.add(this.vehicle);
    this.armMaterial = new THREE.MeshStandardMaterial({ roughness: 0.55 });
    this.arm = new THREE.Mesh(new THREE.BufferGeometry(), this.armMaterial);
    this.arm.castShadow = true;
    this.tipMaterial = new THREE.MeshStandardMaterial({ roughness: 0.35 });
    this.tip = new THREE.Mesh(new THREE.SphereGeometry(0.042, 24, 16), this.tipMaterial);
    this.tip.castShadow = true;
    this.command = buildCommandMarker(INK);
    this.scene.add(this.arm, this.tip, this.command);

    this.layers = {
      reference: this.addLine({ color: INK, linewidth: 1.5 }),
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

  addLine(options) {
    const line = makeLine(options);
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
    if (experiment.target) this.task.add(buildTarget(experiment.target, experiment.limits, INK));
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

  bendArm(quadrotor, attitude, tip, k, next, f) {
    const { arm } = this.experiment;
    const nodes = arm && arm[k].map((node, i) => mix(node, arm[next][i], f));
    this.arm.geometry.dispose();
    this.arm.geometry = new THREE.TubeGeometry(armCurve(quadrotor, attitude, tip, nodes), 32, 0.024, 14);
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
