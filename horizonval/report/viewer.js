"use strict";
(() => {
  const find = (id) => document.getElementById(id);
  const served = "served" in document.documentElement.dataset;
  if (!find("v-frame")) return;
  const blank = { width: 1, height: 1, numbers: null, truth: "", infrared: "", layers: [], heat: null, sight: null, full: 0, black: 0, white: 1 };
  let frames = [...document.querySelectorAll("script.v-data")].map((script) => ({ ...blank, ...JSON.parse(script.textContent) }));
  for (const { sight } of frames) if (typeof sight?.directions === "number") sight.directions = frames[sight.directions].sight.directions;
  // A run's first page has a card of every frame in it; a server knows the run's other frames, too.
  const everything = "whole" in document.querySelector(".viewer").dataset;
  const cards = everything ? [...document.querySelectorAll("#grid .tile")].map((tile, i) => ({ tile, frame: frames[i] })) : [];
  const canvas = find("v-frame"), plot = find("v-profile"), line = find("v-line"), scrub = find("v-scrub");
  const pick = { a: find("v-a"), b: find("v-b") };
  const names = [...pick.a.options].map((option) => option.value).filter(Boolean);
  const marks = { t: find("v-truth"), p: find("v-points"), l: find("v-limb") };
  const state = { frame: 0, zoom: 1, x: null, y: null };
  let image = null, dn = null, pointer = null, drag = null, turn = 0;
  const frame = () => frames[state.frame];

  // What the page does not hold the server reads from the archive; of what it sent the last frames are kept.
  const fetched = [];
  const fetchFrame = async (f) => {
    const answer = await fetch(`/.view/frame?${new URLSearchParams({ case: f.name, band: f.band })}`), found = await answer.json();
    if (!answer.ok) { f.problem = found.problem; return; }
    Object.assign(f, found);
    fetched.push(f);
    if (fetched.length > 30) fetched.shift().numbers = null;
  };
  const fetchList = async () => {
    const answer = await fetch("/.view/frames");
    if (!answer.ok) return;
    const here = new Map(frames.map((f) => [`${f.name} ${f.band}`, f]));
    frames = (await answer.json()).map((f) => here.get(`${f.name} ${f.band}`) ?? { ...blank, ...f });
  };

  const unpack = async (f) => {
    const bytes = Uint8Array.from(atob(f.numbers), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = f.width * f.height, out = new Uint16Array(n);
    for (let i = 0; i < n; i++) {
      const coded = planes[i] | (planes[n + i] << 8), step = (coded >>> 1) ^ -(coded & 1);
      out[i] = i % f.width ? out[i - 1] + step : step;
    }
    return out;
  };

  const scale = () => {
    const f = frame();
    return state.zoom * Math.min(canvas.clientWidth / f.width, canvas.clientHeight / f.height);
  };
  const centre = () => [state.x ?? (frame().width - 1) / 2, state.y ?? (frame().height - 1) / 2];
  const pixelAt = (event) => {
    const box = canvas.getBoundingClientRect(), s = scale(), [x, y] = centre();
    return [x + (event.clientX - box.left - box.width / 2) / s, y + (event.clientY - box.top - box.height / 2) / s];
  };
  const valueAt = (u, v) => {
    const f = frame(), x = Math.round(u), y = Math.round(v);
    return dn && x >= 0 && y >= 0 && x < f.width && y < f.height ? dn[y * f.width + x] : null;
  };

  const warmth = (value) => {
    const heat = frame().heat;
    if (!heat) return "";
    const radiance = heat.zero + heat.step * value, table = heat.temperature_k, last = (table?.length ?? 0) - 1;
    const spectral = `${(radiance / heat.width_um).toPrecision(4)} W m-2 sr-1 um-1`;
    if (!table) return `\n${value < frame().full ? "" : "above "}${spectral}, as on the axis`;
    const text = `\n${radiance.toPrecision(5)} W m-2 sr-1`;
    if (value < 1) return text;
    const low = Math.log(heat.zero + heat.step), high = Math.log(heat.zero + heat.step * frame().full);
    const place = Math.min(last, (last * (Math.log(radiance) - low)) / (high - low)), i = Math.min(last - 1, Math.floor(place));
    return `${text}, ${(1 / (1 / table[i] + (place - i) * (1 / table[i + 1] - 1 / table[i]))).toFixed(2)} K (${spectral})`;
  };
  // Barycentric interpolation between the Chebyshev nodes; see viewer.py.
  const direction = (u, v) => {
    const { sight, width, height } = frame();
    if (!sight) return null;
    const parts = sight.flat ? 2 : 3, n = Math.round(Math.sqrt(sight.directions.length / parts));
    const weights = (at, size) => {
      const places = Array.from({ length: n }, (_, j) => (size - 1 + size * Math.cos((Math.PI * j) / (n - 1))) / 2);
      const hit = places.findIndex((place) => Math.abs(place - at) < 1e-9);
      if (hit >= 0) return places.map((_, j) => Number(j === hit));
      const raw = places.map((place, j) => ((j % 2 ? -1 : 1) * (j === 0 || j === n - 1 ? 0.5 : 1)) / (at - place));
      const sum = raw.reduce((a, b) => a + b);
      return raw.map((one) => one / sum);
    };
    const across = weights(u, width), down = weights(v, height), d = [0, 0, sight.flat ? 1 : 0];
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) for (let k = 0; k < parts; k++) d[k] += down[i] * across[j] * sight.directions[(i * n + j) * parts + k];
    const length = Math.hypot(...d);
    return d.map((one) => one / length);
  };
  const above = (d) => {
    const { nadir, cone: [a, b, c, e, f, g] } = frame().sight, dot = (x, y) => x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    const through = ([x, y, z]) => [a * x + b * y + c * z, b * x + e * y + f * z, c * x + f * y + g * z];
    const side = d.map((one, i) => one - dot(d, nadir) * nadir[i]), length = Math.hypot(...side) || 1, level = side.map((one) => one / length);
    const [A, B, C] = [dot(nadir, through(nadir)), dot(nadir, through(level)), dot(level, through(level))];
    return Math.atan2(dot(d, level), dot(d, nadir)) - Math.atan((-B - Math.sqrt(B * B - A * C)) / C);
  };
  const bearing = (u, v) => {
    const d = direction(u, v);
    if (!d) return "";
    const degrees = 180 / Math.PI, up = above(d) * degrees;
    return `\n${(Math.atan2(Math.hypot(d[0], d[1]), d[2]) * degrees).toFixed(3)}° from the axis, ${Math.abs(up).toFixed(3)}° ${up < 0 ? "below" : "above"} the true horizon`;
  };
  const fit = (c) => {
    const ratio = window.devicePixelRatio || 1;
    c.width = Math.round(c.clientWidth * ratio);
    c.height = Math.round(c.clientHeight * ratio);
    const context = c.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    return context;
  };
  const draw = () => {
    const f = frame(), g = fit(canvas), s = scale(), [x, y] = centre();
    g.translate(canvas.clientWidth / 2 - x * s, canvas.clientHeight / 2 - y * s);
    g.scale(s, s);
    g.imageSmoothingEnabled = false;
    if (image) g.drawImage(image, -0.5, -0.5, f.width, f.height);
    const stroke = (d, colour, width, dash = []) => {
      if (!d) return;
      g.strokeStyle = colour; g.lineWidth = width / s; g.setLineDash(dash.map((part) => part / s)); g.lineCap = dash.length ? "butt" : "round";
      g.stroke(new Path2D(d));
    };
    // Rings and crosses: where both estimators have a point, both are seen.
    const dots = (d, colour, cross) => {
      // Points closer than their marks are thinned out, until the zoom has room for them.
      const path = new Path2D(), r = 3.2 / s, gap = 9 / s, taken = new Set();
      for (const [, u, v] of d.matchAll(/M(\S+) (\S+)h0/g)) {
        const cell = [u, v].map((at) => Math.floor(Number(at) / gap + (cross ? 0.5 : 0))).join();
        if (taken.has(cell)) continue;
        taken.add(cell);
        const [px, py] = [Number(u), Number(v)];
        if (cross) { path.moveTo(px - r, py - r); path.lineTo(px + r, py + r); path.moveTo(px - r, py + r); path.lineTo(px + r, py - r); }
        else { path.moveTo(px + r, py); path.arc(px, py, r, 0, 7); }
      }
      g.strokeStyle = colour; g.lineWidth = 1.3 / s; g.setLineDash([]);
      g.stroke(path);
    };
    const look = { a: ["#f0e442", "#ff7a1a"], b: ["#7fe8b8", "#00c896"] };
    for (const key of ["b", "a"]) {
      const layer = f.layers[names.indexOf(pick[key].value)];
      if (!layer) continue;
      if (marks.l.checked) stroke(layer.limb, look[key][1], 1.6);
      if (marks.p.checked) dots(layer.points, look[key][0], key === "b");
    }
    if (marks.t.checked) { stroke(f.truth, "#56b4e9", 2, [7, 4]); stroke(f.infrared, "#cc79a7", 2); }
  };

  const nearest = (d, [u, v]) => {
    let best = null;
    for (const part of d.split("M").filter(Boolean)) {
      const points = part.split("L").map((text) => text.split(" ").map(Number));
      for (let i = 1; i < points.length; i++) {
        const [[x0, y0], [x1, y1]] = [points[i - 1], points[i]];
        const [dx, dy] = [x1 - x0, y1 - y0], length = Math.hypot(dx, dy);
        if (!length) continue;
        const t = Math.max(0, Math.min(1, ((u - x0) * dx + (v - y0) * dy) / length ** 2));
        const foot = [x0 + t * dx, y0 + t * dy], far = Math.hypot(u - foot[0], v - foot[1]);
        if (!best || far < best.far) best = { far, foot, across: [dy / length, -dx / length] };
      }
    }
    return best;
  };
  const profile = () => {
    const g = fit(plot), w = plot.clientWidth, h = plot.clientHeight, reach = 40;
    const ink = getComputedStyle(document.body).color;
    g.font = "12px system-ui, sans-serif"; g.fillStyle = ink;
    if (!pointer || !dn) { g.fillText("Point at the frame: DN across the true horizon there", 8, h / 2); return; }
    const near = nearest(frame().truth, pointer) ?? { foot: pointer, across: [1, 0] };
    const values = [];
    for (let k = -reach; k <= reach; k++) values.push(valueAt(near.foot[0] + k * near.across[0], near.foot[1] + k * near.across[1]));
    const seen = values.filter((value) => value !== null);
    if (!seen.length) return;
    const [low, high] = [Math.min(...seen), Math.max(...seen)], span = Math.max(1, high - low);
    g.strokeStyle = "#56b4e9"; g.setLineDash([4, 3]); g.beginPath(); g.moveTo(w / 2, 16); g.lineTo(w / 2, h - 18); g.stroke(); g.setLineDash([]);
    g.strokeStyle = ink; g.lineWidth = 1.5; g.beginPath();
    let on = false;
    values.forEach((value, i) => {
      if (value === null) { on = false; return; }
      const at = [(i / (2 * reach)) * w, h - 20 - ((value - low) / span) * (h - 40)];
      if (on) g.lineTo(...at); else g.moveTo(...at);
      on = true;
    });
    g.stroke();
    g.fillText(`${high} DN`, 4, 12); g.fillText(`${low}`, 4, h - 22);
    const words = frame().truth ? "px across the true horizon" : "px along the line (no horizon in view)";
    g.fillText(`-${reach}`, 4, h - 5); g.fillText(`+${reach}`, w - 28, h - 5); g.fillText(words, Math.max(36, w / 2 - 80), h - 5);
  };
  const readOut = () => {
    const value = pointer && valueAt(...pointer), f = frame();
    if (value === null || value === undefined) {
      find("v-value").textContent = dn ? "Point at the frame for its value." : f.problem ?? (served || f.numbers ? "" : "This frame's exact numbers are not in the page: `horizonval view` reads them from the archive.");
    } else {
      const near = frame().truth ? nearest(frame().truth, pointer) : null;
      find("v-value").textContent = `x ${Math.round(pointer[0])}, y ${Math.round(pointer[1])}: ${value} DN of ${frame().full}` + warmth(value) + bearing(Math.round(pointer[0]), Math.round(pointer[1])) +
        (near ? `\n${near.far.toFixed(1)} px from the true horizon` : "");
    }
    profile();
  };

  const remember = () => {
    const f = frame(), words = new URLSearchParams({ frame: state.frame, case: f.name, a: pick.a.value, b: pick.b.value, zoom: +state.zoom.toFixed(3) });
    if (state.x !== null) { words.set("x", state.x.toFixed(1)); words.set("y", state.y.toFixed(1)); }
    const off = Object.keys(marks).filter((key) => !marks[key].checked).join("");
    if (off) words.set("off", off);
    history.replaceState(null, "", `#${words}`);
  };
  const score = () => {
    const cells = (key) => {
      const row = frame().rows[pick[key].value];
      if (!pick[key].value) return null;
      return [`${key.toUpperCase()}: ${pick[key].value}`, row ? `${row.glyph} ${row.label}` : "no result", row?.error || "–", row?.bound || "–", row?.over || "–"];
    };
    find("v-scores").tBodies[0].replaceChildren(...["a", "b"].map(cells).filter(Boolean).map((texts) => {
      const tr = document.createElement("tr");
      tr.append(...texts.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
      return tr;
    }));
  };
  const sunAngle = (f) => (f.sun_deg === null ? "" : `, Sun ${f.sun_deg.toFixed(1)}° from the axis`);
  const key = () => {
    const seen = new Map(frames.map((f) => f.rows[pick.a.value]).filter(Boolean).map((row) => [row.kind, row]));
    find("v-key").replaceChildren(...[...seen.values()].flatMap((row) => {
      const one = document.createElement("span"), swatch = Object.assign(document.createElement("i"), { textContent: row.glyph });
      swatch.style.background = row.colour;
      one.append(swatch, ` ${row.label}`);
      return [one, " "];
    }));
  };
  const mark = () => {
    line.querySelector(".here")?.classList.remove("here");
    line.children[state.frame].classList.add("here");
  };
  const timeline = () => {
    // Many cells leave no room for gaps between them.
    line.classList.toggle("many", frames.length > 150);
    line.replaceChildren(...frames.map((f) => {
      const cell = document.createElement("i"), top = document.createElement("b"), row = f.rows[pick.a.value];
      cell.className = f.sun ? "sun" : f.light;
      cell.title = `${f.name}: ${row ? row.label : "no result"}; ${f.light || "no truth"}${f.sun ? ", Sun in the frame" : ""}${sunAngle(f)}`;
      cell.style.setProperty("--sun", (f.sun_deg ?? 180) / 180);
      top.style.background = row?.colour ?? "#6b7178";
      if (frames.length <= 80) top.textContent = row?.glyph ?? "–";
      cell.append(top, document.createElement("u"));
      return cell;
    }));
    mark();
  };
  const show = async () => {
    const mine = ++turn, f = frame();
    scrub.value = state.frame;
    mark(); score();
    // Until this frame's numbers are there, none must be read as its own.
    dn = image = null;
    find("v-value").textContent = "";
    find("v-name").textContent = `${state.frame + 1} of ${frames.length}: ${f.name}`;
    find("v-facts").textContent = [f.camera, f.band && `band ${f.band}`, f.light, f.sun && "Sun in the frame"].filter(Boolean).join(" · ") + sunAngle(f).replace(", ", " · ");
    if (!f.numbers && served && !f.problem) {
      await fetchFrame(f).catch((error) => { f.problem = `The server does not answer (${error.message}).`; });
      if (mine !== turn) return;
    }
    const got = f.numbers ? await unpack(f) : null;
    if (mine !== turn) return;
    dn = got;
    if (dn) {
      const data = new ImageData(f.width, f.height), grey = new Uint8ClampedArray(65536);
      for (let i = 0; i < 65536; i++) grey[i] = 255 * Math.max(0, Math.min(1, (i - f.black) / (f.white - f.black))) ** (1 / 1.6);
      for (let i = 0; i < dn.length; i++) {
        data.data[4 * i] = data.data[4 * i + 1] = data.data[4 * i + 2] = grey[dn[i]];
        data.data[4 * i + 3] = 255;
      }
      image = Object.assign(document.createElement("canvas"), { width: f.width, height: f.height });
      image.getContext("2d").putImageData(data, 0, 0);
    } else if (f.picture) {
      const picture = new Image();
      picture.src = f.picture;
      await picture.decode();
      if (mine !== turn) return;
      image = picture;
    }
    draw(); readOut();
    canvas.dataset.ready = state.frame;
  };
  const go = (to, keep) => {
    state.frame = Math.max(0, Math.min(frames.length - 1, to));
    if (!keep) { state.x = state.y = null; state.zoom = 1; pointer = null; }
    remember();
    return show();
  };
  const zoom = (by, at = centre()) => {
    const before = state.zoom, [x, y] = centre();
    state.zoom = Math.max(1, Math.min(64, before * by));
    const share = before / state.zoom;
    [state.x, state.y] = state.zoom === 1 ? [null, null] : [at[0] + (x - at[0]) * share, at[1] + (y - at[1]) * share];
    remember(); draw();
  };
  const pan = (dx, dy) => {
    const [x, y] = centre(), f = frame();
    state.x = Math.max(0, Math.min(f.width - 1, x - dx / scale()));
    state.y = Math.max(0, Math.min(f.height - 1, y - dy / scale()));
    remember(); draw();
  };
  // By the keyboard the middle of what is shown stands for the pointer.
  const step = (x, y) => { pan(x * canvas.clientWidth / 8, y * canvas.clientHeight / 8); pointer = centre(); readOut(); };
  const whole = () => { state.zoom = 1; state.x = state.y = null; remember(); draw(); };

  canvas.addEventListener("wheel", (event) => { if (!event.ctrlKey && document.activeElement !== canvas) return; event.preventDefault(); zoom(event.deltaY < 0 ? 1.25 : 0.8, pixelAt(event)); }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => { drag = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); canvas.focus(); });
  canvas.addEventListener("pointerup", () => { drag = null; });
  canvas.addEventListener("pointermove", (event) => {
    if (drag) { pan(event.clientX - drag[0], event.clientY - drag[1]); drag = [event.clientX, event.clientY]; }
    pointer = pixelAt(event);
    readOut();
  });
  canvas.addEventListener("dblclick", (event) => zoom(2, pixelAt(event)));
  line.addEventListener("click", (event) => { const cell = event.target.closest("i"); if (cell) go([...line.children].indexOf(cell)); });
  scrub.addEventListener("input", () => go(Number(scrub.value)));
  for (const select of Object.values(pick)) select.addEventListener("change", () => { remember(); timeline(); key(); score(); draw(); arrange(); });
  for (const box of Object.values(marks)) box.addEventListener("change", () => { remember(); draw(); cards.forEach(overlay); });
  find("v-in").addEventListener("click", () => zoom(1.5));
  find("v-out").addEventListener("click", () => zoom(1 / 1.5));
  find("v-fit").addEventListener("click", whole);
  const help = () => { const box = find("v-help"); box.open = !box.open; };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    if (event.target.closest?.("select, input[type=range]") && event.key.startsWith("Arrow")) return;
    const moves = { ArrowRight: [-1, 0], ArrowLeft: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
    const does = event.shiftKey && moves[event.key] ? () => step(...moves[event.key]) : {
      ArrowRight: () => go(state.frame + 1), ArrowLeft: () => go(state.frame - 1), "+": () => zoom(1.5), "=": () => zoom(1.5),
      "-": () => zoom(1 / 1.5), 0: whole, t: () => marks.t.click(), p: () => marks.p.click(), l: () => marks.l.click(), "?": help,
    }[event.key];
    if (does && !event.target.closest?.("select, textarea")) { event.preventDefault(); does(); }
  });
  window.addEventListener("resize", () => { draw(); profile(); });

  // Cards: curves over their pictures as the viewer draws them; a choice and an order of them by estimator A.
  const [status, camera, order] = ["status", "camera", "order"].map(find);
  const overlay = ({ tile, frame: f }) => {
    const svg = tile.querySelector("svg.image");
    if (!svg) return;
    const layer = f.layers[names.indexOf(pick.a.value)] ?? {};
    const curves = { limb: marks.l.checked && layer.limb, points: marks.p.checked && layer.points, truth: marks.t.checked && f.truth, infrared: marks.t.checked && f.infrared };
    svg.querySelectorAll("path").forEach((path) => path.remove());
    for (const [kind, d] of Object.entries(curves)) {
      if (!d) continue;
      const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
      path.setAttribute("class", kind);
      path.setAttribute("d", d);
      svg.append(path);
    }
  };
  const arrange = () => {
    if (!cards.length) return;
    const error = (card) => card.frame.rows[pick.a.value]?.arcsec ?? null, sign = order.value === "best" ? 1 : -1;
    const sorted = [...cards].sort((a, b) => {
      const [x, y] = [error(a), error(b)];
      // Frames without an error have no place in this order and stand last.
      if (order.value === "suite" || x === y) return 0;
      return x === null || y === null ? (x === null) - (y === null) : sign * (x - y);
    });
    for (const card of sorted) {
      const { tile, frame: f } = card;
      tile.hidden = Boolean((status.value && f.rows[pick.a.value]?.kind !== status.value) || (camera.value && f.camera !== camera.value));
      overlay(card);
    }
    find("grid").append(...sorted.map((card) => card.tile));
    const n = cards.filter((card) => !card.tile.hidden).length;
    find("count").textContent = `${n} of ${cards.length} shown`;
    find("nothing").hidden = n > 0;
  };
  for (const card of cards) {
    card.frame.picture = card.tile.querySelector("image")?.getAttribute("href");
    card.tile.querySelector(".open")?.addEventListener("click", () => {
      go(frames.indexOf(card.frame));
      document.querySelector(".viewer").scrollIntoView();
    });
  }
  for (const select of cards.length ? [status, camera, order] : []) select.addEventListener("change", arrange);

  const restore = () => {
    const text = location.hash.slice(1);
    if (!text.includes("=")) {
      let name = text;
      try { name = decodeURIComponent(text); } catch { /* not ours: taken as it stands */ }
      const named = frames.findIndex((f) => f.name === name || (name && f.scene === name));
      if (named >= 0) state.frame = named;
      return show();
    }
    const words = new URLSearchParams(text), number = (key) => (words.has(key) && Number.isFinite(Number(words.get(key))) ? Number(words.get(key)) : null);
    const numbered = Math.max(0, Math.min(frames.length - 1, Math.trunc(number("frame") ?? 0)));
    // The number decides where both agree, as bands of one case share its name; the name where frames were added since.
    const named = frames[numbered].name === words.get("case") ? numbered : frames.findIndex((f) => f.name === words.get("case"));
    state.frame = named >= 0 ? named : numbered;
    for (const one of ["a", "b"]) if (words.has(one) && [...pick[one].options].some((o) => o.value === words.get(one))) pick[one].value = words.get(one);
    timeline(); key();
    for (const key of Object.keys(marks)) marks[key].checked = !(words.get("off") ?? "").includes(key);
    state.zoom = Math.max(1, Math.min(64, number("zoom") ?? 1));
    [state.x, state.y] = [number("x"), number("y")];
    if (state.x === null || state.y === null) state.x = state.y = null;
    else if (frame().width > 1) [state.x, state.y] = [Math.max(0, Math.min(frame().width - 1, state.x)), Math.max(0, Math.min(frame().height - 1, state.y))];
    return show();
  };
  const start = async () => {
    if (served && everything) await fetchList();
    scrub.max = frames.length - 1;
    timeline(); key();
    window.addEventListener("hashchange", () => restore().then(arrange));
    await restore();
    arrange();
  };
  start();
})();
