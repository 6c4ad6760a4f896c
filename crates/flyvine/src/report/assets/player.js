// The replay's controls: which experiment, where in time, how fast. Rows are the flight's samples.

(() => {
  const section = document.getElementById("replay");
  const content = JSON.parse(document.getElementById("replay-data").textContent);
  const find = (id) => document.getElementById(`replay-${id}`);
  if (!document.createElement("canvas").getContext("webgl2")) {
    find("unavailable").hidden = false;
    find("stage").hidden = true;
    return;
  }

  const speeds = [0.1, 0.25, 0.5, 1, 2, 4];
  const state = { experiment: null, row: 0, playing: false, speed: 1, lastTick: null, dirty: true };
  const scene = new ReplayScene(find("canvas"), () => { state.dirty = true; });

  // Positions travel as integers of 0.1 mm, quaternions [w, x, y, z] of 1e-4; null was not seen.
  function decode(raw) {
    const split = (flat, size, scale) => {
      const items = [];
      for (let i = 0; i < flat.length; i += size) {
        items.push(flat[i] === null ? null : flat.slice(i, i + size).map((v) => v * scale));
      }
      return items;
    };
    const positions = (flat) => split(flat, 3, 1e-4);
    const experiment = {
      ...raw,
      quadrotor: positions(raw.quadrotor),
      attitude: split(raw.attitude, 4, 1e-4).map((q) => q && [q[1], q[2], q[3], q[0]]),
      tip: positions(raw.tip),
      command: positions(raw.command),
      reference: positions(raw.reference),
      predicted: positions(raw.predicted),
      arm: raw.arm && raw.arm.map(positions),
    };
    experiment.rows = experiment.command.length;
    const errors = (to) => experiment.tip.map((p, k) => p && to[k] && 100 * Math.hypot(...p.map((v, i) => v - to[k][i])));
    experiment.toReference = errors(experiment.reference);
    experiment.toPrediction = errors(experiment.predicted);
    // A swing's reference only shapes the cost; what it should do is what was predicted.
    experiment.followed = raw.kind === "swing" ? "prediction" : "reference";
    return experiment;
  }

  const seconds = (row) => row * content.dt;
  const centimetres = (v) => (v === null || v === undefined ? "not seen" : `${v.toFixed(1)} cm`);

  function choose(name) {
    const raw = content.experiments.find((e) => e.name === name);
    if (!raw) return;
    state.experiment = decode(raw);
    find("choice").value = name;
    const scrubber = find("scrubber");
    scrubber.max = state.experiment.rows - 1;
    scene.show(state.experiment);
    drawErrors();
    seek(0);
  }

  function seek(row) {
    const last = state.experiment.rows - 1;
    state.row = Math.min(Math.max(row, 0), last);
    state.dirty = true;
    scene.update(state.row);
    showNumbers();
  }

  function showNumbers() {
    const e = state.experiment;
    const k = Math.min(Math.floor(state.row + 1e-6), e.rows - 1);
    const time = `${seconds(state.row).toFixed(2)} s of ${seconds(e.rows - 1).toFixed(2)} s`;
    const scrubber = find("scrubber");
    scrubber.value = state.row;
    scrubber.setAttribute("aria-valuetext", time);
    find("time").textContent = time;
    find("to-reference").textContent = centimetres(e.toReference[k]);
    find("to-prediction").textContent = centimetres(e.toPrediction[k]);
    const q = e.attitude[k];
    // Angle between the body's z axis and the vertical: cos = 1 − 2 (q_x² + q_y²).
    const tilt = q && (180 / Math.PI) * Math.acos(Math.min(1, 1 - 2 * (q[0] * q[0] + q[1] * q[1])));
    find("tilt").textContent = q ? `${tilt.toFixed(0)}°` : "not seen";
    const [length, pressure] = e.configurations.length === 1 ? e.configurations[0] : e.configurations[k];
    find("arm").textContent = `${length.toFixed(2)} m, ${pressure.toFixed(2)} kPa`;
    find("cursor").setAttribute("transform", `translate(${(1000 * state.row) / Math.max(e.rows - 1, 1)} 0)`);
  }

  // The error over time, right above the scrubber and as wide.
  function drawErrors() {
    const e = state.experiment;
    const ours = e.followed === "reference" ? e.toReference : e.toPrediction;
    const largest = Math.max(1, ...ours.filter((v) => v !== null));
    const x = (k) => (1000 * k) / Math.max(e.rows - 1, 1);
    let data = "";
    ours.forEach((v, k) => {
      if (v === null) return;
      const pen = k === 0 || ours[k - 1] === null ? "M" : "L";
      data += `${pen}${x(k).toFixed(1)} ${(62 - (54 * v) / largest).toFixed(1)}`;
    });
    find("errors").setAttribute("d", data);
    find("errors").setAttribute("stroke", e.color);
    find("target-mark").setAttribute("d", e.target ? `M${x(e.targetKnot).toFixed(1)} 0V64` : "");
    find("errors-label").textContent = `Distance of the end effector to the ${e.followed}, up to ${largest.toFixed(1)} cm`;
  }

  function play(playing) {
    if (playing && state.row >= state.experiment.rows - 1) seek(0);
    state.playing = playing;
    state.lastTick = null;
    const button = find("play");
    button.textContent = playing ? "Pause" : "Play";
    button.setAttribute("aria-pressed", String(playing));
    section.classList.toggle("playing", playing);
    if (playing) section.classList.add("started");
  }

  function setSpeed(speed) {
    state.speed = speed;
    find("speed").value = String(speed);
  }

  function shiftSpeed(steps) {
    const i = speeds.indexOf(state.speed) + steps;
    setSpeed(speeds[Math.min(Math.max(i, 0), speeds.length - 1)]);
  }

  function tick(now) {
    if (state.playing) {
      const elapsed = state.lastTick === null ? 0 : Math.min((now - state.lastTick) / 1000, 0.25);
      state.lastTick = now;
      const row = state.row + (state.speed * elapsed) / content.dt;
      const last = state.experiment.rows - 1;
      if (row < last) seek(row);
      else if (find("loop").checked) seek(0);
      else {
        seek(last);
        play(false);
      }
    }
    if (state.dirty) {
      state.dirty = false;
      scene.render();
    }
    requestAnimationFrame(tick);
  }

  for (const experiment of content.experiments) {
    find("choice").add(new Option(experiment.title, experiment.name));
  }
  find("choice").addEventListener("change", (event) => choose(event.target.value));
  find("play").addEventListener("click", () => play(!state.playing));
  find("overlay").addEventListener("click", () => play(true));
  find("scrubber").addEventListener("input", (event) => {
    play(false);
    seek(Number(event.target.value));
  });
  speeds.forEach((speed) => find("speed").add(new Option(`${speed} ×`, speed)));
  find("speed").addEventListener("change", (event) => setSpeed(Number(event.target.value)));
  for (const box of section.querySelectorAll("[data-layer]")) {
    const apply = () => {
      scene.setLayer(box.dataset.layer, box.checked);
      if (state.experiment) seek(state.row);
    };
    box.addEventListener("change", apply);
    apply();
  }
  for (const button of section.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => {
      scene.setView(button.dataset.view);
      state.dirty = true;
      for (const other of section.querySelectorAll("[data-view]")) {
        other.setAttribute("aria-pressed", String(other === button));
      }
    });
  }
  for (const link of document.querySelectorAll("[data-replay]")) {
    link.addEventListener("click", () => {
      choose(link.dataset.replay);
      section.scrollIntoView({ block: "start" });
      play(true);
    });
  }

  // Keys work while the replay is on screen and no other control wants them.
  let visible = true;
  new IntersectionObserver(([entry]) => { visible = entry.intersectionRatio > 0.4; }, { threshold: [0.4, 0.5] })
    .observe(find("stage"));
  const keys = {
    " ": () => play(!state.playing),
    ArrowLeft: (event) => { play(false); seek(Math.ceil(state.row) - (event.shiftKey ? 20 : 1)); },
    ArrowRight: (event) => { play(false); seek(Math.floor(state.row) + (event.shiftKey ? 20 : 1)); },
    ArrowUp: () => shiftSpeed(1),
    ArrowDown: () => shiftSpeed(-1),
    Home: () => seek(0),
    End: () => seek(state.experiment.rows - 1),
  };
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("select, textarea, input:not([type=range], [type=checkbox])");
    const pressing = event.key === " " && event.target.closest("a, button, summary, [type=checkbox]");
    if (!visible || typing || pressing || event.ctrlKey || event.altKey || event.metaKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key](event);
  });

  new ResizeObserver(() => {
    scene.resize();
    state.dirty = true;
  }).observe(find("canvas"));
  setSpeed(1);
  scene.resize();
  choose(content.experiments[0].name);
  requestAnimationFrame(tick);
})();
