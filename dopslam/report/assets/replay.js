// Replay of a run: scene, base station, true and estimated track, rays and map of one step, with a time slider.
// Reads the tree that dopslam/report/replay.py makes from #replay-data; needs THREE (three.bundle.js) on the page.
(function () {
  "use strict";
  window.addEventListener("error", (event) => { document.documentElement.dataset.error = event.message; });
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const stage = document.getElementById("replay-stage");
  const readout = document.getElementById("replay-readout");
  const slider = document.getElementById("replay-step");
  const COLOR = { truth: 0x111111, estimate: 0x0072b2, va: 0xe69f00, sp: 0x009e73, ray: 0x9aa5b1, wall: 0xaab4c0, lit: 0xfff6d8, edge: 0xb37a00, bs: 0xd55e00 };
  const KIND = ["base station", "virtual anchor", "scatter point", "second reflection"];
  const names = Object.keys(data.filters);
  const steps = data.time.length;
  const track = data.truth || data.filters[names[0]]; // what the picture is made around
  const state = { step: 0, filter: names[0], enlarge: 1, playing: false, show: { scene: true, rays: true, map: true, truth: true, walls: true, names: true } };
  window.replay = state; // for tests and for the curious

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true });
  } catch (error) {
    stage.textContent = "This browser shows no WebGL; the table and the figures below say the same.";
    return;
  }
  stage.appendChild(renderer.domElement);
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xf7f8fa);
  scene.add(new THREE.AmbientLight(0xffffff, 2.0));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6);
  sun.position.set(0.4, -0.7, 1.0);
  scene.add(sun);

  // The view frames what a person wants to see: track, base station and what the rays touch, not far virtual anchors.
  const framed = [...track.position, data.bs];
  data.rays.forEach((rays) => rays.forEach((ray) => framed.push(...ray[1])));
  if (!data.rays.length) framed.push(...data.landmarks.filter((l) => l.kind === 2).map((l) => l.position));
  names.forEach((n) => data.filters[n].walls[steps - 1].forEach((wall) => { if (wall[2]) framed.push(...wall[0]); }));
  const frame = new THREE.Box3();
  framed.forEach((p) => frame.expandByPoint(new THREE.Vector3(...p)));
  const center = frame.getCenter(new THREE.Vector3());
  const size = Math.max(frame.getSize(new THREE.Vector3()).length(), 1);
  const camera = new THREE.PerspectiveCamera(45, 1, size / 2000, size * 40);
  camera.up.set(0, 0, 1);
  camera.aspect = stage.clientWidth / height(stage.clientWidth);
  camera.updateProjectionMatrix();
  const controls = new THREE.OrbitControls(camera, renderer.domElement);
  controls.target.copy(center);
  for (let far = 0.4; far < 8; far *= 1.06) { // as near as shows all of it; a phone held upright sees less to the sides
    camera.position.set(center.x - 0.2 * far * size, center.y - 0.6 * far * size, center.z + 0.8 * far * size);
    controls.update(); // turns the camera there
    camera.updateMatrixWorld();
    if (fits()) break;
  }
  controls.addEventListener("change", draw);

  const group = {};
  ["scene", "lit", "truth", "rays", "map", "walls", "now"].forEach((key) => scene.add((group[key] = new THREE.Group())));

  function fits() {
    return framed.every((point) => {
      const p = new THREE.Vector3(...point).project(camera);
      return Math.max(Math.abs(p.x), Math.abs(p.y)) < 0.9;
    });
  }

  // Names over the picture: text that stays upright and sharp, moved with what it names at every drawing.
  let tags = [];
  function tag(position, text, color) {
    const element = document.createElement("div");
    element.className = "tag";
    element.textContent = text;
    element.style.color = color || "#1c2430";
    stage.appendChild(element);
    tags.push([element, new THREE.Vector3(...position)]);
  }
  function place() {
    const box = renderer.domElement.getBoundingClientRect();
    tags.forEach(([element, position]) => {
      const p = position.clone().project(camera);
      const seen = state.show.names && Math.abs(p.x) < 1 && Math.abs(p.y) < 1 && p.z < 1;
      element.style.display = seen ? "" : "none";
      if (seen) element.style.transform = "translate(" + (0.5 * (p.x + 1) * box.width + 8) + "px, " + (0.5 * (1 - p.y) * box.height - 20) + "px)";
    });
  }

  function clear(g) {
    while (g.children.length) {
      const child = g.children[0];
      g.remove(child);
      child.geometry.dispose();
    }
  }
  function line(points, color, dashed, opacity) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
    const options = { color: color, transparent: true, opacity: opacity === undefined ? 1 : opacity };
    const material = dashed
      ? new THREE.LineDashedMaterial({ ...options, dashSize: size / 120, gapSize: size / 160 })
      : new THREE.LineBasicMaterial(options);
    const result = new THREE.Line(geometry, material);
    if (dashed) result.computeLineDistances();
    return result;
  }
  function dots(points, color) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
    return new THREE.Points(geometry, new THREE.PointsMaterial({ color: color, size: 5, sizeAttenuation: false }));
  }
  const ball = new THREE.SphereGeometry(1, 20, 14);
  function sphere(position, radius, color, opacity) {
    const mesh = new THREE.Mesh(ball.clone(), new THREE.MeshLambertMaterial({ color: color, transparent: opacity < 1, opacity: opacity }));
    mesh.scale.setScalar(radius);
    mesh.position.set(...position);
    return mesh;
  }
  function ellipsoid(position, f, color, opacity, least) {
    // The unit sphere under the Cholesky factor of the covariance is its 1 σ ellipsoid; 2.8 σ holds 95 % in space.
    const k = 2.8 * state.enlarge;
    const mesh = new THREE.Mesh(ball.clone(), new THREE.MeshLambertMaterial({ color: color, transparent: true, opacity: opacity }));
    mesh.matrixAutoUpdate = false;
    mesh.matrix.set(
      Math.max(Math.abs(k * f[0]), least), 0, 0, position[0],
      k * f[1], Math.max(Math.abs(k * f[2]), least), 0, position[1],
      k * f[3], k * f[4], Math.max(Math.abs(k * f[5]), least), position[2],
      0, 0, 0, 1);
    return mesh;
  }
  function triangles(corners, color, opacity) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
    geometry.computeVertexNormals();
    return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: color, side: THREE.DoubleSide, transparent: true, opacity: opacity, depthWrite: opacity > 0.9 }));
  }

  function quad(c, color, opacity) {
    return triangles([...c[0], ...c[1], ...c[2], ...c[0], ...c[2], ...c[3]], color, opacity);
  }

  let corners = null;
  if (data.mesh) {
    const raw = Uint8Array.from(atob(data.mesh), (c) => c.charCodeAt(0));
    corners = new Float32Array(raw.buffer);
    const all = triangles(corners, COLOR.wall, 0.22);
    group.scene.add(all);
    const edges = new THREE.LineSegments(new THREE.EdgesGeometry(all.geometry, 20), new THREE.LineBasicMaterial({ color: 0x8792a0, transparent: true, opacity: 0.5 }));
    group.scene.add(edges);
  } else {
    const z = track.position[0][2];
    data.outlines.forEach((points) => group.scene.add(line(points.map((p) => [p[0], p[1], z]), COLOR.wall)));
  }
  // A grid of 1, 2 or 5 times a power of ten says how large everything is.
  const ten = Math.pow(10, Math.floor(Math.log10(size / 6)));
  const mesh = ten * [5, 2, 1].find((n) => n * ten <= size / 6);
  const lines = 2 * Math.ceil(size / mesh);
  const grid = new THREE.GridHelper(lines * mesh, lines, 0xc3cad2, 0xd9dee4);
  grid.rotation.x = Math.PI / 2;
  grid.position.set(Math.round(center.x / mesh) * mesh, Math.round(center.y / mesh) * mesh, Math.min(0, frame.min.z));
  group.scene.add(grid);
  const scale = document.createElement("div");
  scale.className = "scale";
  scale.textContent = "grid " + mesh + " m";
  stage.appendChild(scale);
  if (data.truth) group.truth.add(line(data.truth.position, COLOR.truth));
  group.scene.add(sphere(data.bs, size / 90, COLOR.bs, 1));
  data.landmarks.filter((l) => l.kind === 2).forEach((l) => group.truth.add(sphere(l.position, size / 260, COLOR.truth, 0.7)));

  function render(step) {
    const filter = data.filters[state.filter];
    ["rays", "map", "walls", "now", "lit"].forEach((key) => clear(group[key]));
    tags.forEach(([element]) => element.remove());
    tags = [];
    tag(data.bs, "base station", "#a84300");
    const shown = data.truth || filter;
    if (step > 0) tag(shown.position[0], "start");
    tag(shown.position[step], step === steps - 1 ? "receiver, at the end" : "receiver");
    const here = shown.position[step], own = data.truth ? COLOR.truth : COLOR.estimate;
    if (data.truth) group.now.add(sphere(here, size / 140, COLOR.truth, 1));
    const heading = shown.heading[step];
    group.now.add(line([here, [here[0] + Math.cos(heading) * size / 25, here[1] + Math.sin(heading) * size / 25, here[2]]], own));
    const rays = data.rays[step] || [];
    const seen = new Set(rays.map((ray) => ray[0]));
    rays.forEach((ray) => group.rays.add(line(ray[1], COLOR.ray)));
    rays.forEach((ray) => ray[1].slice(1, -1).forEach((p) => group.rays.add(sphere(p, size / 300, COLOR.ray, 1))));
    if (corners)
      seen.forEach((landmark) => {
        const faces = data.lit[landmark];
        if (!faces) return;
        const lit = new Float32Array(9 * faces.length);
        faces.forEach((face, i) => lit.set(corners.subarray(9 * face, 9 * face + 9), 9 * i));
        group.lit.add(triangles(lit, COLOR.lit, 0.35));
      });
    if (filter) {
      const path = filter.position.slice(0, step + 1);
      if (path.length > 1) group.now.add(line(path, COLOR.estimate));
      group.now.add(dots(path, COLOR.estimate));
      const ue = filter.position[step], f = filter.factor[step];
      group.now.add(ellipsoid(ue, [f[0], f[1], f[2], 0, 0, 0], COLOR.estimate, 0.55, size / 700));
      group.now.add(sphere(ue, size / 180, COLOR.estimate, 1));
      filter.map[step].forEach((row) => {
        const color = row[3] === 2 ? COLOR.sp : COLOR.va, opacity = 0.25 + 0.6 * row[4];
        group.map.add(ellipsoid(row.slice(0, 3), row.slice(8), color, opacity, size / (row[3] === 2 ? 170 : 700)));
        group.map.add(line([data.bs, row.slice(5, 8), ue], color, true, 0.35 + 0.6 * row[4]));
        group.map.add(sphere(row.slice(5, 8), size / 300, color, opacity));
      });
      filter.walls[step].forEach(([c, shift, name]) => {
        if (state.show.walls && name) tag(c[2].map((v, i) => 0.5 * (v + c[3][i])), name, "#8a5a00");
        group.walls.add(quad(c, COLOR.va, 0.55));
        group.walls.add(line([...c, c[0]], COLOR.edge));
        [-1, 1].forEach((side) => {
          const edge = c.map((p) => p.map((v, i) => v + side * state.enlarge * shift[i]));
          group.walls.add(quad(edge, COLOR.va, 0.14));
        });
      });
    }
    group.scene.visible = state.show.scene;
    group.rays.visible = state.show.rays;
    group.lit.visible = state.show.rays && state.show.scene;
    group.map.visible = state.show.map;
    group.truth.visible = state.show.truth;
    group.walls.visible = state.show.walls;
    readout.textContent = text(step, filter, seen.size);
    draw();
  }
  function length(metres) {
    return metres < 0.1 ? (1e3 * metres).toPrecision(2) + " mm" : metres.toFixed(3) + " m";
  }
  function text(step, filter, count) {
    let out = "step " + (step + 1) + " of " + steps + " · " + data.time[step].toFixed(1) + " s";
    if (data.rays.length) out += " · " + count + " true paths";
    if (filter) {
      const p = filter.position[step], t = data.truth && data.truth.position[step];
      if (t) out += " · error " + length(Math.hypot(p[0] - t[0], p[1] - t[1]));
      else out += " · says of its position ± " + length(Math.hypot(...filter.factor[step]));
      const tally = {};
      filter.map[step].forEach((row) => (tally[row[3]] = (tally[row[3]] || 0) + 1));
      out += " · map: " + (Object.keys(tally).map((k) => tally[k] + " " + KIND[k] + (tally[k] > 1 ? "s" : "")).join(", ") || "empty");
    }
    return out;
  }
  function draw() {
    renderer.render(scene, camera);
    place();
  }
  function height(width) {
    return Math.max(300, Math.min(620, Math.round((width < 600 ? 0.85 : 0.62) * width), window.innerHeight - 120));
  }
  function resize() {
    const width = stage.clientWidth;
    renderer.setSize(width, height(width));
    camera.aspect = width / height(width);
    camera.updateProjectionMatrix();
    draw();
  }
  function go(step) {
    state.step = Math.max(0, Math.min(steps - 1, step));
    slider.value = state.step;
    render(state.step);
    camera.updateMatrixWorld();
    const seen = new THREE.Vector3(...track.position[state.step]).project(camera); // within ±1: in the picture
    stage.dataset.receiver = seen.x.toFixed(3) + " " + seen.y.toFixed(3);
  }
  slider.max = steps - 1;
  slider.addEventListener("input", () => go(Number(slider.value)));
  const button = document.getElementById("replay-play");
  let timer = 0;
  button.addEventListener("click", () => {
    state.playing = !state.playing;
    button.textContent = state.playing ? "❚❚" : "▶";
    clearInterval(timer);
    if (state.playing) timer = setInterval(() => go(state.step + 1 < steps ? state.step + 1 : 0), Math.max(60, Math.min(250, 20000 / steps)));
  });
  const choice = document.getElementById("replay-filter");
  names.forEach((name) => choice.add(new Option(name, name)));
  choice.addEventListener("change", () => { state.filter = choice.value; render(state.step); });
  document.getElementById("replay-enlarge").addEventListener("input", (event) => { state.enlarge = Math.pow(10, Number(event.target.value)); render(state.step); });
  document.querySelectorAll("[data-layer]").forEach((box) =>
    box.addEventListener("change", () => { state.show[box.dataset.layer] = box.checked; render(state.step); }));
  window.addEventListener("resize", resize);
  resize();
  const wanted = /step=(\d+)/.exec(location.hash); // report.html#step=12 opens at a step; otherwise the end, with the whole map
  go(wanted ? Number(wanted[1]) - 1 : steps - 1);
  stage.dataset.ready = "yes";
})();
