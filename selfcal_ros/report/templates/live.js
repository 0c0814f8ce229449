/* The live page: shows what the node sends, asks for images while it is seen, sends buttons. */
'use strict';
(() => {
  const find = id => document.getElementById(id);
  const token = document.querySelector('meta[name=token]').content;
  const SIGNS = {
    left: 'M30 42V24a10 10 0 0 0-10-10H8m10-10L8 14l10 10', right: 'M18 42V24a10 10 0 0 1 10-10h12M30 4l10 10-10 10',
    move: 'M24 42V8M10 20L24 6l14 14', done: 'M6 26l12 12L42 10',
    trouble: 'M24 6v24m0 10v.5', wait: 'M24 6a18 18 0 1 0 18 18'};
  const AFTER_S = 3, AGAIN_MS = 1500, SURE_MS = 4000, ANSWER_MS = 30000, ENOUGH_DEG = 30, MOST_DEG = 60;
  let stale = 0, socket = null, failures = 0, shown = 0, address = '', asking = false;

  const words = (id, text) => { if (find(id).textContent !== text) find(id).textContent = text; };
  const drawn = (name, attributes, text) => {
    const made = document.createElementNS('http://www.w3.org/2000/svg', name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  };
  /* as many digits as the sigma bears; what rounds to zero has no sign */
  const digits = sigma => Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(sigma))));
  const rounded = (value, n) => (Number(value.toFixed(n)) || 0).toFixed(n);

  const advise = (kind, what, why) => {
    find('head').dataset.kind = kind;
    document.querySelector('.sign path').setAttribute('d', SIGNS[kind] || SIGNS.wait);
    words('do', what);
    words('why', why);
    document.title = `${what} – camera calibration`;
  };

  const parameters = state => {
    const rows = state.parameters.filter(one => one.value !== null).map(one => {
      const row = document.createElement('tr'), sure = !(one.sigma > 0);
      const n = sure ? (one.value === 0 ? 0 : 4) : digits(one.sigma);
      /* a file of another program tells no sigma */
      const spread = one.sigma === null ? 'not told' : sure ? 'held' : '± ' + one.sigma.toFixed(n);
      for (const [text, kind] of [[one.name, 'name'], [rounded(one.value, n), 'n'],
                                  [spread, 'n']]) {
        const cell = document.createElement('td');
        cell.textContent = text;
        cell.className = kind;
        row.append(cell);
      }
      return row;
    });
    find('parameters').replaceChildren(...rows);
    document.querySelector('#numbers table').hidden = !rows.length;
    const own = state.source === 'estimate';
    words('state', own ? 'Calibrated' : rows.length ? 'Calibration of an earlier run' : 'Not calibrated');
    words('kept', state.kept);
    find('save').classList.toggle('ready', own && !state.is_saved);
    const rms = state.rms_px === null ? '' : `Reprojection ${state.rms_px.toFixed(3)} px rms, ` +
      `motion ${state.motion}.`;
    words('text', state.alive && own && state.is_well ? rms : state.text);
  };

  const chart = (history, now) => {
    const svg = find('chart'), names = ['focal', 'centre'];
    find('nochart').hidden = history.length > 0;
    for (const one of [svg, document.querySelector('#fall .key')]) {
      one.toggleAttribute('hidden', !history.length);
    }
    if (!history.length) return;
    const values = history.flatMap(one => names.map(name => one[name])).filter(v => v > 0);
    let low = Math.floor(Math.log10(Math.min(...values))), high = Math.ceil(Math.log10(Math.max(...values)));
    if (high === low) high += 1;
    const began = history[0].t, span = Math.max(now - began, 1);
    const x = t => 44 + 306 * (t - began) / span, y = v => 12 + 150 * (high - Math.log10(v)) / (high - low);
    const parts = [];
    for (let power = low; power <= high; power++) {
      const at = y(10 ** power);
      parts.push(drawn('line', {class: 'grid', x1: 44, x2: 350, y1: at, y2: at}),
                 drawn('text', {x: 38, y: at + 4, 'text-anchor': 'end'}, String(+(10 ** power).toPrecision(1))));
    }
    parts.push(drawn('text', {x: 350, y: 182, 'text-anchor': 'end'},
                     span < 120 ? `${span.toFixed(0)} s` : `${(span / 60).toFixed(1)} min`),
               drawn('text', {x: 44, y: 182}, 'since the first estimate'));
    for (const name of names) {
      const points = [...history, {...history[history.length - 1], t: now}].filter(one => one[name] > 0)
        .flatMap((one, k, all) => [...(k ? [[x(one.t), y(all[k - 1][name])]] : []), [x(one.t), y(one[name])]]);
      if (!points.length) continue;
      parts.push(drawn('polyline', {class: name, points: points.map(p => p.map(v => v.toFixed(1)).join()).join(' ')}));
      const [cx, cy] = points[points.length - 1];
      parts.push(drawn('circle', {class: name, cx, cy, r: 3.5}));
      const newest = history[history.length - 1][name];
      document.querySelector(`.key .${name} b`).textContent = newest.toFixed(digits(newest));
    }
    svg.replaceChildren(...parts);
  };

  const map = state => {
    const {columns, rows, cells, share} = state.coverage, [width, height] = state.size || [4, 3];
    const w = width / columns, h = height / rows, svg = find('map');
    svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
    svg.replaceChildren(...cells.map((value, k) => drawn('rect', {
      x: w * (k % columns), y: h * Math.floor(k / columns), width: w, height: h,
      'fill-opacity': (0.85 * value).toFixed(2), 'stroke-width': width / 200})));
    words('share', `${(100 * share).toFixed(0)} % of the image`);
  };

  const turns = turned => {
    for (const side of ['left', 'right']) {
      const bar = document.querySelector(`.turn.${side}`), value = turned[side];
      bar.firstElementChild.style.width = `${Math.min(100, 100 * value / MOST_DEG)}%`;
      bar.classList.toggle('enough', value >= ENOUGH_DEG);
      words(side, `${value.toFixed(0)}°`);
    }
  };

  const show = state => {
    if (!state.advice) return;
    advise(state.advice.kind, state.advice.do, state.advice.why);
    words('camera', state.camera);
    words('points', state.points === null ? '' : `${state.points} points in the newest image`);
    words('views', `${state.keyframes} views kept of ${state.frames}`);
    find('estimating').hidden = !state.estimating;
    parameters(state);
    chart(state.history, state.now);
    map(state);
    turns(state.turned);
    words('note', state.note);
    words('foot', state.calibrator ? `Watching /${state.calibrator}` : '');
  };

  const ask = () => {
    if (socket && socket.readyState === WebSocket.OPEN && !document.hidden) socket.send('image');
  };

  const picture = blob => {
    const image = find('image'), next = URL.createObjectURL(blob);
    image.onload = image.onerror = () => {
      if (address) URL.revokeObjectURL(address);
      address = next;
      shown = Date.now();
      image.hidden = false;
      find('noimage').hidden = true;
      image.parentElement.classList.remove('old');
      ask();
    };
    image.src = next;
  };

  const connect = () => {
    const next = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(token)}`);
    next.binaryType = 'blob';
    next.onopen = () => { socket = next; failures = 0; ask(); };
    next.onmessage = ({data}) => typeof data === 'string' ? show(JSON.parse(data)) : picture(data);
    next.onclose = async () => {
      socket = null;
      failures += 1;
      advise('trouble', 'The node has gone', 'The page waits for it to come back.');
      if (failures > 1) {
        /* the node is there again, but of another run: its page has another token */
        const there = await fetch('live.css').then(answer => answer.ok, () => false);
        if (there && !location.search) return location.reload();
        if (there) advise('trouble', 'Open the page anew', 'The node prints another address at each start.');
      }
      setTimeout(connect, AGAIN_MS);
    };
  };

  const press = async name => {
    if (asking) return;
    asking = true;
    clearTimeout(stale);
    const answer = find('answer');
    answer.className = '';
    answer.textContent = '…';
    try {
      const got = await fetch(name, {method: 'POST', headers: {'X-Token': token}});
      const said = got.ok ? await got.json() : {success: false, message: await got.text()};
      answer.className = said.success ? 'good' : 'bad';
      answer.textContent = said.message;
    } catch {
      answer.className = 'bad';
      answer.textContent = 'The node does not answer.';
    }
    asking = false;
    if (answer.className === 'good') stale = setTimeout(() => { answer.textContent = ''; }, ANSWER_MS);
  };

  for (const name of ['calibrate', 'save']) find(name).addEventListener('click', () => press(name));
  /* what was learned is gone after it: it wants a second press */
  let calm = 0;
  const reset = find('reset'), settle = () => { reset.classList.remove('sure'); reset.textContent = 'Reset'; };
  reset.addEventListener('click', () => {
    clearTimeout(calm);
    if (reset.classList.contains('sure')) { settle(); press('reset'); return; }
    reset.classList.add('sure');
    reset.textContent = 'Forget everything?';
    calm = setTimeout(settle, SURE_MS);
  });

  document.addEventListener('visibilitychange', ask);
  setInterval(() => {
    if (shown && Date.now() - shown > 1000 * AFTER_S) find('image').parentElement.classList.add('old');
    /* who waits for an image says so, or the node takes it that nobody looks */
    if (Date.now() - shown > 1000) ask();
  }, 1000);
  advise('wait', 'Connecting', 'to the node on this page.');
  connect();
})();
