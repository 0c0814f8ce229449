'use strict';
// Shows the camera path and the structure; drag turns, wheel and pinch zoom, keys do both.
(function () {
  document.documentElement.classList.add('js');
  const figure = document.getElementById('viewer');
  if (!figure) { return; }
  const canvas = figure.querySelector('canvas');
  const context = canvas.getContext('2d');
  if (!context) { document.documentElement.classList.remove('js'); return; }
  const scene = JSON.parse(figure.dataset.scene);

  function bytes(text) { return Uint8Array.from(atob(text), c => c.charCodeAt(0)); }
  function floats(text) {
    const view = new DataView(bytes(text).buffer);
    return Float32Array.from({ length: view.byteLength / 4 }, (_, k) => view.getFloat32(4 * k, true));
  }
  const cameras = floats(scene.cameras), views = cameras.length / 12;
  const points = floats(scene.points), count = points.length / 3;
  const colours = scene.colours ? bytes(scene.colours) : null;

  // what is to be in view: the path and most of the points
  function percentile(values, share) {
    const sorted = Array.from(values).sort((a, b) => a - b);
    return sorted.length ? sorted[Math.round(share * (sorted.length - 1))] : 0;
  }
  const low = [], high = [];
  const pathLow = [], pathHigh = [];
  for (let axis = 0; axis < 3; axis++) {
    const path = cameras.filter((_, k) => k % 12 === axis);
    const cloud = points.filter((_, k) => k % 3 === axis);
    pathLow.push(path.reduce((a, b) => Math.min(a, b)));
    pathHigh.push(path.reduce((a, b) => Math.max(a, b)));
    low.push(count ? Math.min(pathLow[axis], percentile(cloud, 0.06)) : pathLow[axis]);
    high.push(count ? Math.max(pathHigh[axis], percentile(cloud, 0.94)) : pathHigh[axis]);
  }
  const middle = low.map((value, k) => (value + high[k]) / 2);
  const size = Math.max(Math.hypot(...low.map((value, k) => high[k] - value)), 1e-6);
  let floor = (pathLow[2] + pathHigh[2]) / 2;
  if (!scene.path) { floor = 0; }
  const reach = Math.max(Math.min(0.035 * size, scene.path ? 1.6 : size), 0.014 * size);

  const ahead = [0, 1, 2].map(axis => {
    let sum = 0;
    for (let k = 0; k < views; k++) { sum += cameras[12 * k + 9 + axis]; }
    return sum / views;
  });
  // from behind the cameras and above them
  const start = {
    yaw: Math.atan2(ahead[1], ahead[0]) + 0.5, pitch: scene.path ? 0.6 : 0.45,
    distance: 1.25 * size, centre: middle
  };
  let now = { ...start }, chosen = 'behind', touched = false;

  // the eye looks along `forward`, `right` and `up` span the picture
  let basis, scale, width, height;
  function look() {
    const [cy, sy, cp, sp] = [Math.cos(now.yaw), Math.sin(now.yaw), Math.cos(now.pitch),
      Math.sin(now.pitch)];
    const forward = [cp * cy, cp * sy, -sp], right = [sy, -cy, 0];
    const up = [sp * cy, sp * sy, cp];
    const eye = now.centre.map((value, k) => value - now.distance * forward[k]);
    basis = { forward, right, up, eye };
    scale = 1.15 * Math.min(width, 1.35 * height);
  }
  const near = () => 0.02 * now.distance;
  function inEye(x, y, z) {
    const { forward, right, up, eye } = basis, d = [x - eye[0], y - eye[1], z - eye[2]];
    const dot = a => a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
    return [dot(right), dot(up), dot(forward)];
  }
  const toScreen = p => [width / 2 + scale * p[0] / p[2], height / 2 - scale * p[1] / p[2]];

  function line(a, b) {
    let p = inEye(...a), q = inEye(...b);
    if (p[2] < near() && q[2] < near()) { return; }
    if (p[2] < near() || q[2] < near()) {
      if (p[2] > q[2]) { [p, q] = [q, p]; }
      const s = (near() - p[2]) / (q[2] - p[2]);
      p = p.map((value, k) => value + s * (q[k] - value));
    }
    context.moveTo(...toScreen(p));
    context.lineTo(...toScreen(q));
  }

  const palette = ['#440154', '#46327e', '#365c8d', '#277f8e', '#1fa187', '#4ac16d', '#a0da39',
    '#fde725'].map(hex => [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16)));
  const darkPalette = palette.map(c => c.map(v => Math.round(v + (255 - v) * 0.32)));
  let colour = {};
  function readColours() {
    const style = getComputedStyle(figure);
    for (const name of ['ink', 'soft', 'rule', 'card', 'faint']) {
      colour[name] = style.getPropertyValue('--' + name).trim();
    }
    colour.dark = matchMedia('(prefers-color-scheme: dark)').matches;
  }
  function alongPath(share) {
    const colours = colour.dark ? darkPalette : palette;
    const place = Math.min(share * (colours.length - 1), colours.length - 1.001);
    const k = Math.floor(place), s = place - k;
    return 'rgb(' + colours[k].map((v, c) => Math.round(v + s * (colours[k + 1][c] - v))) + ')';
  }

  function roundStep(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return power * [1, 2, 5, 10].find(m => m * power >= 0.999 * value);
  }
  const step = roundStep(size / 14);
  function drawGrid() {
    const from = k => step * Math.floor(low[k] / step), to = k => step * Math.ceil(high[k] / step);
    context.beginPath();
    for (let x = from(0); x <= to(0) + step / 2; x += step) {
      line([x, from(1), floor], [x, to(1), floor]);
    }
    for (let y = from(1); y <= to(1) + step / 2; y += step) {
      line([from(0), y, floor], [to(0), y, floor]);
    }
    context.strokeStyle = colour.rule;
    context.lineWidth = 1;
    context.stroke();
  }

  function drawPoints() {
    const seen = [];
    for (let k = 0; k < count; k++) {
      const p = inEye(points[3 * k], points[3 * k + 1], points[3 * k + 2]);
      if (p[2] > near()) { seen.push([p[2], k, ...toScreen(p)]); }
    }
    seen.sort((a, b) => b[0] - a[0]);
    const large = Math.min(4, Math.max(1.5, 90 / Math.sqrt(count + 1)));
    context.fillStyle = colour.soft;
    for (const [depth, k, x, y] of seen) {
      const side = Math.max(1.2, Math.min(scene.path ? 5 : 7, large * now.distance / depth));
      if (colours) {
        let [r, g, b] = colours.subarray(3 * k, 3 * k + 3);
        // paper-white and night-black points would not be seen on their ground
        const light = (0.3 * r + 0.59 * g + 0.11 * b) || 1;
        const f = colour.dark ? Math.max(1, 95 / light) : Math.min(1, 165 / light);
        [r, g, b] = [r, g, b].map(v => Math.min(255, Math.round(f * v)));
        context.fillStyle = `rgb(${r},${g},${b})`;
      }
      context.fillRect(x - side / 2, y - side / 2, side, side);
    }
  }

  function corner(k, c) {
    const at = 12 * k, [x, y] = scene.corners[c];
    return [0, 1, 2].map(i => cameras[at + i] + reach * (x * cameras[at + 3 + i]
      + y * cameras[at + 6 + i] + cameras[at + 9 + i]));
  }
  const centre = k => Array.from(cameras.subarray(12 * k, 12 * k + 3));
  function drawCameras() {
    context.lineJoin = 'round';
    if (scene.path) {
      context.beginPath();
      for (let k = 0; k + 1 < views; k++) { line(centre(k), centre(k + 1)); }
      context.strokeStyle = colour.ink;
      context.lineWidth = 1.4;
      context.stroke();
    }
    const stride = Math.max(1, Math.ceil(views / 30));
    for (let k = 0; k < views; k += stride) {
      const corners = [0, 1, 2, 3].map(c => corner(k, c));
      context.beginPath();
      for (let c = 0; c < 4; c++) {
        line(centre(k), corners[c]);
        line(corners[c], corners[(c + 1) % 4]);
      }
      context.strokeStyle = alongPath(views > 1 ? k / (views - 1) : 0);
      context.lineWidth = 1.6;
      context.stroke();
    }
    if (scene.path) {
      const first = label(centre(0), 'first view', 15);
      // one above, the other below, where they would meet
      const p = inEye(...centre(views - 1)), last = p[2] > near() && toScreen(p);
      const meet = first && last && Math.abs(first[0] - last[0]) < 80
        && Math.abs(first[1] - last[1]) < 22;
      label(centre(views - 1), 'last view', meet ? -8 : 15);
    }
  }
  function label(place, text, below) {
    const p = inEye(...place);
    if (p[2] < near()) { return null; }
    const [x, y] = toScreen(p);
    context.beginPath();
    context.arc(x, y, 3.2, 0, 7);
    context.fillStyle = colour.ink;
    context.fill();
    context.font = '600 12px ' + getComputedStyle(figure).fontFamily;
    context.lineWidth = 4;
    context.strokeStyle = colour.card;
    context.strokeText(text, x + 8, y + below);
    context.fillText(text, x + 8, y + below);
    return [x, y];
  }

  // come as near as the picture allows, so that the path and most of the points fill it
  function fit() {
    const shown = [];
    for (let k = 0; k < views; k++) { shown.push(centre(k)); }
    for (let k = 0; k < count; k += Math.ceil(count / 800)) {
      const p = Array.from(points.subarray(3 * k, 3 * k + 3));
      if (p.every((value, axis) => value >= low[axis] && value <= high[axis])) { shown.push(p); }
    }
    for (let round = 0; round < 6; round++) {
      look();
      const seen = shown.map(p => inEye(...p)).filter(p => p[2] > near()).map(toScreen);
      const [left, right, top, bottom] = [
        Math.min(...seen.map(p => p[0])), Math.max(...seen.map(p => p[0])),
        Math.min(...seen.map(p => p[1])), Math.max(...seen.map(p => p[1]))];
      if (!(right - left + bottom - top > 0)) { return; }
      shift((width - left - right) / 2, (height - top - bottom) / 2);
      const used = Math.max((right - left) / (0.86 * width), (bottom - top) / (0.84 * height));
      now.distance *= Math.min(Math.max(used, 0.6), 1.6);
    }
    look();
  }

  let waiting = false;
  function draw() {
    waiting = false;
    const ratio = window.devicePixelRatio || 1;
    width = canvas.clientWidth;
    height = canvas.clientHeight;
    if (!width || !height) { return; }
    const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) {
      [canvas.width, canvas.height] = pixels;
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!touched) { place(chosen); }
    look();
    drawGrid();
    drawPoints();
    drawCameras();
    canvas.dataset.view = [now.yaw, now.pitch, now.distance].map(v => v.toFixed(4)).join(' ');
  }
  function redraw() {
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  }

  function turn(dx, dy) {
    touched = true;
    now.yaw -= dx;
    now.pitch = Math.min(Math.max(now.pitch + dy, -1.55), 1.55);
    redraw();
  }
  function zoom(factor) {
    touched = true;
    now.distance = Math.min(Math.max(now.distance * factor, 0.04 * size), 8 * size);
    redraw();
  }
  function shift(dx, dy) {
    const f = now.distance / scale;
    now.centre = now.centre.map((v, k) => v - f * dx * basis.right[k] + f * dy * basis.up[k]);
  }

  const fingers = new Map();
  canvas.addEventListener('pointerdown', event => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
    canvas.classList.add('held');
  });
  canvas.addEventListener('pointermove', event => {
    const before = fingers.get(event.pointerId);
    if (!before) { return; }
    const after = [event.clientX, event.clientY];
    const dx = after[0] - before[0], dy = after[1] - before[1];
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = p => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      zoom(apart(before) / apart(after));
      shift(dx / 2, dy / 2);
      redraw();
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
      touched = true;
      shift(dx, dy);
      redraw();
    } else {
      turn(dx / 160, dy / 160);
    }
    fingers.set(event.pointerId, after);
  });
  for (const name of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(name, event => {
      fingers.delete(event.pointerId);
      if (!fingers.size) { canvas.classList.remove('held'); }
    });
  }
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  // a wheel that is scrolling the page does not stop at the picture
  let scrolled = -1e9;
  window.addEventListener('scroll', () => { scrolled = performance.now(); }, { passive: true });
  canvas.addEventListener('wheel', event => {
    if (performance.now() - scrolled < 250) { return; }
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    const factor = Math.exp(Math.min(Math.max(pixels, -200), 200) / 500);
    // what is under the pointer stays there
    const box = canvas.getBoundingClientRect();
    shift((factor - 1) * (event.clientX - box.left - width / 2),
      (factor - 1) * (event.clientY - box.top - height / 2));
    zoom(factor);
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1),
    ArrowDown: () => turn(0, -0.1), '+': () => zoom(0.87), '=': () => zoom(0.87),
    '-': () => zoom(1.15), '0': () => view('behind'), Home: () => view('behind')
  };
  canvas.addEventListener('keydown', event => {
    if (keys[event.key] && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      keys[event.key]();
    }
  });

  function place(name) {
    now = { ...start };
    if (name === 'above') { now.pitch = 1.55; now.yaw = start.yaw - 0.5; }
    if (name === 'side') { now.pitch = 0.06; now.yaw = start.yaw + 1.1; }
    fit();
  }
  function view(name) {
    [chosen, touched] = [name, false];
    redraw();
  }
  for (const button of figure.querySelectorAll('button')) {
    button.addEventListener('click', () => view(button.value));
  }
  figure.querySelector('.step').textContent = Number(step.toPrecision(3));

  new ResizeObserver(redraw).observe(canvas);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    readColours();
    redraw();
  });
  readColours();
  draw();
}());
