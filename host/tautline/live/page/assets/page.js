// The live page. It holds no knowledge of its own: what the server publishes by topic (about, state, frame, doing, progress, fit, holds, diagnosis) is drawn.
const $ = (id) => document.getElementById(id);
const shown = { about: null, state: null, progress: null, fit: null, frame: null };
const trace = []; // {t_s, q, c_deg} of the last seconds
const TRACE_S = 20;
const STATES = { ready: "ready", running: "running", resting: "resting", stopping: "stopping", lost: "not connected" };

// -- drawing: SVG made by hand --------------------------------------------------------------------------------------

function make(name, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

function ticks(low, high, most) {
  const rough = (high - low) / most, ten = 10 ** Math.floor(Math.log10(rough));
  const step = ten * [1, 2, 5, 10].find((times) => times * ten >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(10)));
  return found;
}

// A plot's frame with its axes; x and y are from values to px.
function axes(svg, box, xs, ys, options) {
  const x = (value) => box.left + ((value - xs[0]) / (xs[1] - xs[0])) * box.width;
  const y = (value) => box.top + box.height - ((value - ys[0]) / (ys[1] - ys[0])) * box.height;
  for (const value of ticks(...ys, options.yTicks)) {
    svg.append(make("line", { class: "axis", x1: box.left, x2: box.left + box.width, y1: y(value), y2: y(value) }));
    svg.append(make("text", { class: "tick", x: box.left - 6, y: y(value) + 4, "text-anchor": "end" }, value));
  }
  if (options.xLabel) {
    for (const value of ticks(...xs, Math.max(3, Math.min(8, box.width / 60))))
      svg.append(make("text", { class: "tick", x: x(value), y: box.top + box.height + 16, "text-anchor": "middle" }, value));
    svg.append(make("text", { class: "label", x: box.left + box.width, y: box.top + box.height + 32, "text-anchor": "end" }, options.xLabel));
  }
  svg.append(make("text", { class: "label", x: box.left, y: box.top - 7 }, options.yLabel));
  return { x, y };
}

const path = (points) => points.map(([x, y], k) => `${k ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

function cleared(id) {
  const svg = $(id);
  svg.replaceChildren();
  const { width, height } = svg.getBoundingClientRect();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  return { svg, width, height };
}

const inner = (width, height, bottom) => ({ left: 46, top: 22, width: width - 56, height: height - 22 - bottom });

function triangle(x, y, up) {
  const d = up ? -1 : 1;
  return `M${x.toFixed(1)} ${(y + 4.5 * d).toFixed(1)}l4.5 ${-8 * d}h-9z`;
}

function drawBacklash() {
  if (!shown.about) return;
  const { svg, width, height } = cleared("backlash");
  const { fit, progress, about, frame } = shown;
  const known = fit && fit.q.length ? fit.q.map((q, k) => [q, fit.width[k], fit.sigma[k]]).filter((row) => row[1] !== null) : [];
  const onsets = fit ? fit.onsets : [];
  const found = progress && about.live ? progress.onsets : [];
  const most = Math.max(...known.map((row) => row[1] + 2 * (row[2] ?? 0)), ...onsets.filter((o) => o.used).map((o) => o.width), ...(known.length ? [] : found.map((o) => o.width)), 0);
  const top = most > 0 ? 1.15 * most : 1;
  const { x, y } = axes(svg, inner(width, height, 36), about.range, [0, top], { yTicks: 5, yLabel: `B, ${about.unit}`, xLabel: `motor q, ${about.unit}` });
  if (known.length) {
    const band = known.filter((row) => row[2] !== null);
    const edge = (side) => band.map(([q, w, s]) => [x(q), y(Math.max(w + 2 * side * s, 0))]);
    if (band.length) svg.append(make("path", { class: "band", d: path([...edge(1), ...edge(-1).reverse()]) + "Z" }));
  }
  for (const o of found) if (o.width <= top) svg.append(make("path", { class: "board", d: `M${x(o.q) - 3} ${y(o.width)}h6m-3 -3v6` }));
  for (const o of onsets.filter((o) => o.width <= top)) {
    const way = o.direction > 0 ? "up" : "down", told = 2 * (o.sigma ?? Infinity) <= o.width; // a wider bar says nothing: it is faint, without
    if (o.used && told)
      svg.append(make("line", { class: `bar ${way}`, x1: x(o.q), x2: x(o.q), y1: y(o.width - 2 * o.sigma), y2: y(Math.min(o.width + 2 * o.sigma, top)) }));
    svg.append(make("path", { class: o.used ? way : "hollow", "fill-opacity": told ? 1 : 0.3, d: triangle(x(o.q), y(o.width), o.direction > 0) }));
  }
  if (known.length) svg.append(make("path", { class: "curve", d: path(known.map(([q, w]) => [x(q), y(w)])) }));
  if (frame && frame.q !== null) svg.append(make("line", { class: "now", x1: x(frame.q), x2: x(frame.q), y1: y(0), y2: y(top) }));
  const used = onsets.filter((o) => o.used).length;
  svg.setAttribute("aria-label", known.length
    ? `B(q) from ${number(known[0][0])} to ${number(known.at(-1)[0])} ${about.unit}, ${number(Math.min(...known.map((r) => r[1])))} to ${number(Math.max(...known.map((r) => r[1])))} ${about.unit} wide, from ${used} onsets`
    : "B(q) is not known yet");
}

function drawCoverage() {
  const { progress, about } = shown;
  if (!progress || !about) return;
  const { svg, width } = cleared("coverage");
  const box = { left: 46, width: width - 56 };
  ["rising", "falling"].forEach((way, row) => {
    const bins = progress[way], step = box.width / bins.length, y = 4 + 28 * row;
    svg.append(make("text", { class: "tick", x: box.left - 6, y: y + 15, "text-anchor": "end" }, row ? "falls" : "rises"));
    bins.forEach(([seen, lost], k) => {
      const kind = lost > seen ? "away" : seen ? (row ? "down" : "up") : "empty";
      const opacity = kind === "empty" || kind === "away" ? 1 : 0.35 + 0.65 * Math.min(seen / 8, 1);
      svg.append(make("rect", { class: kind, x: box.left + k * step + 0.5, y, width: Math.max(step - 1, 1), height: 20, "fill-opacity": opacity }));
    });
  });
  const share = (way) => Math.round((100 * progress[way].filter(([seen]) => seen > 0).length) / progress[way].length);
  svg.setAttribute("aria-label", `seen with q rising over ${share("rising")} %, with q falling over ${share("falling")} % of the range`);
}

function drawTrace() {
  if (!shown.about || trace.length < 2) return;
  const { svg, width, height } = cleared("trace");
  const end = trace.at(-1).t_s, times = [end - TRACE_S, end], each = (height - 60) / 2;
  [["q", shown.about.range, `q, ${shown.about.unit}`], ["c_deg", shown.about.c_range, "c, deg"]].forEach(([key, range, label], row) => {
    const points = trace.filter((row) => row[key] !== null);
    const values = points.map((point) => point[key]);
    const low = Math.min(range[0], ...values), high = Math.max(range[1], ...values);
    const box = { left: 46, top: 20 + row * (each + 24), width: width - 56, height: each };
    const { x, y } = axes(svg, box, times, [low, high], { yTicks: 4, yLabel: label });
    if (points.length > 1) svg.append(make("path", { class: key === "q" ? "q" : "c", d: path(points.map((point) => [x(point.t_s), y(point[key])])) }));
  });
  svg.append(make("text", { class: "tick", x: width - 10, y: height - 2, "text-anchor": "end" }, `the last ${TRACE_S} s`));
}

// -- what the topics say --------------------------------------------------------------------------------------------

const number = (value) => Number(value.toPrecision(3)).toString();
const fixed = (value, digits, unit) => (value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`);

function list(id, items, none) {
  $(id).replaceChildren(...(items.length ? items : [none]).map((item) => {
    const li = document.createElement("li");
    li.append(...[item].flat());
    return li;
  }));
}

const topics = {
  about(about) {
    document.title = `${about.title} – taut live`;
    $("title").textContent = about.title;
    document.body.classList.toggle("replay", !about.live);
    document.body.classList.toggle("watch", Boolean(about.watch));
    document.body.classList.toggle("diagnose", Boolean(about.diagnose));
    $("rest").hidden = about.rests === false;
    if (about.watch || about.diagnose) $("verdict-title").textContent = "Verdict of its calibration";
  },
  state({ state, says }) {
    $("state").textContent = STATES[state];
    $("state").className = `state ${state}`;
    $("says").textContent = says;
    $("start").disabled = !["ready", "resting"].includes(state);
    $("start").textContent = state === "resting" ? "Go on" : "Start";
    $("rest").disabled = state !== "running";
    $("stop").disabled = !["running", "resting", "stopping"].includes(state);
    if (state === "running" && !shown.began) trace.length = 0;
    if (state === "ready") $("doing").textContent = "";
    shown.began = state !== "ready";
    const picks = state === "ready" && shown.about?.live && !shown.about.watch && !shown.about.diagnose;
    $("picture").classList.toggle("picks", picks);
    $("hint").textContent = picks ? "Click on the marker to pick its colour; with the keyboard: arrow keys, then Enter." : "";
  },
  doing({ doing, share }) {
    if (!shown.began) return;
    $("doing").textContent = doing;
    $("share").value = share;
  },
  diagnosis(found) {
    $("cause").textContent = found ? found.says : "nothing was recorded yet";
    $("next").textContent = found?.next ? `What tells most comes next: ${found.next}.` : "";
    $("led").replaceChildren(...(found ? found.led : []).map((leading, k) => {
      const li = document.createElement("li");
      li.textContent = `after recording ${k + 1}: ${leading}`;
      return li;
    }));
    $("answers").replaceChildren(...(found ? found.answers : []).flatMap(({ id, probability }) => {
      const name = document.createElement("dt"), value = document.createElement("dd"), bar = document.createElement("i");
      name.textContent = id;
      value.textContent = `${(100 * probability).toFixed(0)} %`;
      bar.style.width = `calc((100% - 3.6em) * ${probability})`; // beside the number
      value.append(bar);
      return [name, value];
    }));
  },
  progress(progress) {
    $("doing").textContent = progress.doing;
    $("known").textContent = `${progress.seen}. ${progress.known}.`;
    $("share").value = progress.share;
    list("missing", progress.missing, "nothing");
    drawCoverage();
    drawBacklash();
  },
  fit(fit) {
    if (!fit) { // begun again
      $("verdict").className = "verdict";
      $("verdict").textContent = "none yet";
      $("reasons").replaceChildren();
      drawBacklash();
      return;
    }
    const strong = document.createElement("strong");
    strong.textContent = fit.verdict;
    $("verdict").className = `verdict ${fit.verdict}`;
    const from = fit.seconds === null ? "" : ` from the first ${fit.seconds.toFixed(1)} s,`;
    $("verdict").replaceChildren(strong, `${from} the image ${fit.delay_ms.toFixed(0)} ms late`);
    list("reasons", fit.reasons.map(({ code, says, remedy }) => {
      const name = document.createElement("code");
      name.textContent = code;
      return [name, ` ${says}: ${remedy}`];
    }), "no doubts");
    drawBacklash();
  },
  holds({ state, reason, offset, offset_sigma, scale, scale_sigma }) {
    $("holds").textContent = state;
    $("holds").className = `state ${state}`;
    $("reason").textContent = reason;
    $("learnt").textContent = `offset ${fixed(offset, 4, "")} ± ${fixed(offset_sigma, 4, shown.about?.unit ?? "")}, B times ${fixed(scale, 3, "")} ± ${fixed(scale_sigma, 3, "")}`;
  },
  frame(frame) {
    $("q").textContent = fixed(frame.q, 3, shown.about?.unit ?? "");
    $("c").textContent = fixed(frame.c_deg, 2, "deg");
    $("time").textContent = fixed(frame.t_s, 1, "s");
    if (trace.length && frame.t_s < trace.at(-1).t_s) trace.length = 0;
    trace.push(frame);
    while (trace[0].t_s < frame.t_s - TRACE_S) trace.shift();
    soon(drawTrace);
    soon(drawBacklash); // where the motor is
  },
};

const waiting = new Set();
function soon(draw) { // at most once a frame of the screen
  if (waiting.has(draw)) return;
  waiting.add(draw);
  requestAnimationFrame(() => { waiting.delete(draw); draw(); });
}

function connect() {
  const source = new EventSource("events");
  for (const [topic, take] of Object.entries(topics))
    source.addEventListener(topic, (event) => { shown[topic] = JSON.parse(event.data); take(shown[topic]); });
  source.addEventListener("alive", () => ask("here").catch(() => {}));
  source.addEventListener("error", () => topics.state({ state: "lost", says: "The page has lost taut: is it still running? The axis comes to rest by itself." }));
  source.addEventListener("open", () => shown.state && topics.state(shown.state));
}

// -- the picture ----------------------------------------------------------------------------------------------------

const canvas = $("picture");
let cross = null; // where the keyboard points, px of the picture
let latest = null; // the bitmap and what was seen in it

function drawPicture() {
  if (!latest) return;
  const { bitmap, seen } = latest;
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  canvas.parentElement.style.aspectRatio = `${bitmap.width} / ${bitmap.height}`;
  const pen = canvas.getContext("2d");
  pen.drawImage(bitmap, 0, 0);
  pen.lineWidth = Math.max(1.5, bitmap.width / 400);
  pen.strokeStyle = "#fff";
  if (seen.u_px !== null) {
    const radius = (seen.diameter_px ?? 16) / 2 + 4;
    pen.beginPath();
    pen.arc(seen.u_px, seen.v_px, radius, 0, 2 * Math.PI);
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      pen.moveTo(seen.u_px + dx * (radius + 3), seen.v_px + dy * (radius + 3));
      pen.lineTo(seen.u_px + dx * (radius + 14), seen.v_px + dy * (radius + 14));
    }
    pen.stroke();
  }
  if (cross) {
    pen.strokeStyle = "#ffd54a";
    pen.beginPath();
    pen.moveTo(cross[0], 0); pen.lineTo(cross[0], bitmap.height);
    pen.moveTo(0, cross[1]); pen.lineTo(bitmap.width, cross[1]);
    pen.stroke();
  }
  canvas.setAttribute("aria-label", seen.u_px === null ? `the marker is lost: ${seen.lost}` : `the marker is at ${seen.u_px.toFixed(0)}, ${seen.v_px.toFixed(0)} px`);
}

async function pictures() {
  for (let after = 0; ; ) {
    try {
      const answer = await fetch(`picture?after=${after}`);
      if (answer.status === 204) continue; // none came yet
      if (!answer.ok) throw new Error("another server's");
      after = Number(answer.headers.get("Taut-Number"));
      const seen = JSON.parse(answer.headers.get("Taut-Seen"));
      const bitmap = await createImageBitmap(await answer.blob());
      latest?.bitmap.close();
      latest = { bitmap, seen };
      $("nothing").hidden = true;
      drawPicture();
    } catch {
      await new Promise((resolve) => setTimeout(resolve, 1000)); // the server is away, or knows this page no more
    }
  }
}

// -- what the person asks for ---------------------------------------------------------------------------------------

const ask = (what, body = {}) => fetch(what, { method: "POST", body: JSON.stringify(body) });

for (const what of ["start", "rest", "stop"]) $(what).addEventListener("click", () => ask(what));
document.addEventListener("keydown", (event) => { if (event.key === "Escape") ask("stop"); });

const pick = (u_px, v_px) => { if (canvas.classList.contains("picks")) ask("pick", { u_px, v_px }); };
canvas.addEventListener("click", (event) => {
  const box = canvas.getBoundingClientRect();
  pick(((event.clientX - box.left) / box.width) * canvas.width, ((event.clientY - box.top) / box.height) * canvas.height);
});
canvas.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (step && canvas.classList.contains("picks")) {
    event.preventDefault();
    cross ??= [canvas.width / 2, canvas.height / 2];
    cross = cross.map((value, k) => value + step[k] * (event.shiftKey ? 1 : 8));
    drawPicture();
  } else if (event.key === "Enter" && cross) {
    pick(...cross);
    cross = null;
  }
});

new ResizeObserver(() => { drawBacklash(); drawCoverage(); drawTrace(); }).observe(document.body);
connect();
pictures();
