"use strict";
const film = JSON.parse(document.getElementById("film").textContent);
const byId = (name) => document.getElementById(name);
const last = film.times.length - 1;
const DASHES = [[], [6, 3], [2, 2]];
let now = 0;

function make(tag, parent, text) {
  const found = document.createElement(tag);
  if (text !== undefined) found.textContent = text;
  parent.append(found);
  return found;
}

// Numbers round enough to be read, from low to high, at most about `most` of them.
function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return found.map((value) => [value, value.toFixed(Math.min(digits, 20)).replace("-", "−")]);
}

// A canvas with axes: `toX`, `toY` turn data into pixels inside the plot's frame.
class Plot {
  constructor(figure, labels) {
    this.canvas = make("canvas", figure);
    this.labels = labels;
  }
  open(width, height, x, y) {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.canvas.style.height = `${height}px`;
    const pen = (this.pen = this.canvas.getContext("2d"));
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const frame = (this.frame = { left: 52, top: 6, right: width - 14, bottom: height - 34 });
    this.toX = (value) => frame.left + ((value - x[0]) / (x[1] - x[0])) * (frame.right - frame.left);
    this.toY = (value) => frame.bottom - ((value - y[0]) / (y[1] - y[0])) * (frame.bottom - frame.top);
    if (this.labels.some(Boolean)) this.rule(x, y);
  }
  rule(x, y) {
    const { pen, frame } = this;
    pen.font = "12px Georgia, serif";
    pen.strokeStyle = "#e4e4e4";
    pen.fillStyle = "#444";
    pen.lineWidth = 1;
    pen.beginPath();
    pen.textAlign = "center";
    for (const [value, text] of ticks(...x, (frame.right - frame.left) / 70)) {
      pen.moveTo(this.toX(value), frame.top);
      pen.lineTo(this.toX(value), frame.bottom);
      pen.fillText(text, this.toX(value), frame.bottom + 15);
    }
    pen.textAlign = "right";
    for (const [value, text] of ticks(...y, (frame.bottom - frame.top) / 35)) {
      pen.moveTo(frame.left, this.toY(value));
      pen.lineTo(frame.right, this.toY(value));
      pen.fillText(text, frame.left - 5, this.toY(value) + 4);
    }
    pen.stroke();
    pen.textAlign = "center";
    pen.fillText(this.labels[0], (frame.left + frame.right) / 2, frame.bottom + 30);
    pen.save();
    pen.translate(12, (frame.top + frame.bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(this.labels[1], 0, 0);
    pen.restore();
  }
  inside(draw) {
    const { pen, frame } = this;
    pen.save();
    pen.beginPath();
    pen.rect(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top);
    pen.clip();
    draw(pen);
    pen.restore();
    pen.strokeStyle = "#777";
    pen.beginPath();
    pen.moveTo(frame.left, frame.top);
    pen.lineTo(frame.left, frame.bottom);
    pen.lineTo(frame.right, frame.bottom);
    pen.stroke();
  }
}

// Ways to lay the line around a shape into a path, in metres.
const OUTLINES = {
  Circle: (path, [x, y, r]) => path.arc(x, y, r, 0, 2 * Math.PI),
  Rectangle: (path, [x, y, width, height, angle, rounding]) => {
    const box = new Path2D(), r = Math.min(rounding, width / 2, height / 2);
    if (r > 0) box.roundRect(-width / 2, -height / 2, width, height, r);
    else box.rect(-width / 2, -height / 2, width, height);
    path.addPath(box, new DOMMatrix().translate(x, y).rotate((angle * 180) / Math.PI));
  },
  Stadium: (path, [x1, y1, x2, y2, r]) => {
    const along = Math.atan2(y2 - y1, x2 - x1);
    path.arc(x2, y2, r, along - Math.PI / 2, along + Math.PI / 2);
    path.arc(x1, y1, r, along + Math.PI / 2, along + (3 * Math.PI) / 2);
    path.closePath();
  },
  Outline: (path, [corners, radius]) => {
    const many = corners.length, side = (k) => {
      const [x1, y1, x2, y2] = [0, 1, 2, 3].map((i) => corners[(k + i) % many]);
      return [x1, y1, x2, y2, Math.atan2(x1 - x2, y2 - y1)];
    };
    for (let k = 0; k < many; k += 2) {
      const [x1, y1, x2, y2, out] = side(k), next = side(k + 2)[4];
      path.lineTo(x1 + radius * Math.cos(out), y1 + radius * Math.sin(out));
      if (radius > 0) path.arc(x2, y2, radius, out, next);
    }
    path.closePath();
  },
  Segment: (path, [x1, y1, x2, y2]) => { path.moveTo(x1, y1); path.lineTo(x2, y2); },
  Spring: (path, [x1, y1, x2, y2]) => {
    const length = Math.hypot(x2 - x1, y2 - y1) || 1, many = 2 * film.coils + 1;
    const [ex, ey] = [(x2 - x1) / length, (y2 - y1) / length];
    path.moveTo(x1, y1);
    for (let k = 1; k <= many; k++) {
      const place = (k / many) * length, side = k === many ? 0 : k % 2 ? film.coil : -film.coil;
      path.lineTo(x1 + ex * place - ey * side, y1 + ey * place + ex * side);
    }
  },
  Wall: (path, [x, y, nx, ny], middle, reach) => {
    const share = (middle[0] - x) * -ny + (middle[1] - y) * nx;
    const [px, py] = [x - ny * share, y + nx * share];
    path.moveTo(px + ny * reach, py - nx * reach);
    path.lineTo(px - ny * reach, py + nx * reach);
    path.lineTo(px - (ny + nx) * reach, py + (nx - ny) * reach);
    path.lineTo(px + (ny - nx) * reach, py - (nx + ny) * reach);
    path.closePath();
  },
};
const LINES = { Segment: 2.2, Spring: 1.1 };
const LEVEL = { Wall: 0, Segment: 2, Spring: 2, Mark: 2 };
const SHADED = ["Circle", "Outline", "Stadium", "Segment"];
// How dark the inside of a shape is that hides others, else zero.
const shadeOf = ([kind, ...numbers]) => (SHADED.includes(film.kinds[kind][0]) ? numbers.at(-1) : 0);
const level = (shape) => {
  const [kind, role] = film.kinds[shape[0]];
  return shadeOf(shape) > 0 ? 1 : role === "goal" ? 4 : LEVEL[kind] ?? 1;
};

class Picture extends Plot {
  constructor(parent, motion) {
    const figure = make("figure", parent);
    make("figcaption", figure, motion.title);
    super(figure, film.axes);
    this.motion = motion;
  }
  draw() {
    const { motion } = this, [wide, high] = film.size;
    const middle = motion.middle[Math.min(now, motion.middle.length - 1)];
    const width = this.canvas.clientWidth, room = width - 60;
    const height = Math.min(Math.max((room * high) / wide, 60), 440) + 40;
    // Equal scales: where the height is limited, more of the surroundings is seen.
    const scale = Math.min(room / wide, (height - 40) / high);
    const half = [room / scale / 2, (height - 40) / scale / 2];
    this.open(width, height, [middle[0] - half[0], middle[0] + half[0]],
      [middle[1] - half[1], middle[1] + half[1]]);
    this.inside((pen) => {
      if (now >= motion.frames.length) return;
      const shapes = [...motion.fixed, ...motion.frames[now]];
      shapes.sort((a, b) => level(a) - level(b));
      for (const shape of shapes) this.shape(pen, shape, middle, 4 * (half[0] + half[1]));
      for (const push of motion.arrows[now] ?? []) this.arrow(pen, push, scale);
    });
  }
  // Lay a path of metres into pixels, so that lines keep their width.
  placed(path) {
    const x = this.toX(1) - this.toX(0), y = this.toY(1) - this.toY(0), found = new Path2D();
    found.addPath(path, new DOMMatrix([x, 0, 0, y, this.toX(0), this.toY(0)]));
    return found;
  }
  shape(pen, [index, ...numbers], middle, reach) {
    const [kind, role] = film.kinds[index], ink = film.colors[role] ?? "#7A7A7A";
    const shade = shadeOf([index, ...numbers]);
    pen.strokeStyle = pen.fillStyle = ink;
    pen.lineWidth = LINES[kind] ?? 1.2;
    pen.lineCap = "round";
    if (kind === "Mark") return this.mark(pen, this.toX(numbers[0]), this.toY(numbers[1]), role);
    const path = new Path2D();
    OUTLINES[kind](path, numbers, middle, reach);
    const line = this.placed(path);
    if (kind === "Wall") {
      pen.fillStyle = "#d9d9d9";
      pen.fill(line);
    } else if (kind in LINES && shade > 0) {
      pen.lineWidth = 1.2;
      pen.globalAlpha = shade;
    } else if (!(kind in LINES)) {
      if (shade > 0) {
        pen.fillStyle = "#fff";
        pen.fill(line);
        pen.fillStyle = ink;
      }
      pen.globalAlpha = shade || 0.25;
      pen.fill(line);
      pen.globalAlpha = 1;
    }
    pen.stroke(line);
    pen.globalAlpha = 1;
  }
  mark(pen, x, y, role) {
    pen.beginPath();
    if (role !== "goal") {
      pen.arc(x, y, 3.2, 0, 2 * Math.PI);
      return pen.fill();
    }
    pen.lineWidth = 2;
    pen.moveTo(x - 8, y);
    pen.lineTo(x + 8, y);
    pen.moveTo(x, y - 8);
    pen.lineTo(x, y + 8);
    return pen.stroke();
  }
  arrow(pen, [x, y, fx, fy, nx, ny, friction], scale) {
    const long = (film.longest / film.largest) * scale, start = [this.toX(x), this.toY(y)];
    if (film.cones && friction) {
      const way = Math.atan2(-ny, nx), half = Math.atan(friction);
      pen.beginPath();
      pen.moveTo(...start);
      pen.arc(...start, 0.7 * film.longest * scale, way - half, way + half);
      pen.closePath();
      pen.globalAlpha = 0.25;
      pen.fillStyle = film.colors.cone;
      pen.fill();
      pen.globalAlpha = 1;
    }
    const size = Math.hypot(fx, fy) * long, way = Math.atan2(-fy, fx), head = Math.min(8, size);
    pen.save();
    pen.translate(...start);
    pen.rotate(way);
    pen.strokeStyle = pen.fillStyle = film.colors.force;
    pen.lineWidth = 1.8;
    pen.beginPath();
    pen.moveTo(0, 0);
    pen.lineTo(size - head, 0);
    pen.stroke();
    pen.beginPath();
    pen.moveTo(size, 0);
    pen.lineTo(size - head, head * 0.4);
    pen.lineTo(size - head, -head * 0.4);
    pen.fill();
    pen.restore();
  }
}

// Curves over time under the pictures, with a line at the time that is shown.
class Chart extends Plot {
  constructor(parent, chart) {
    const figure = make("figure", parent);
    if (chart.wide) figure.className = "wide";
    make("figcaption", figure, chart.title);
    super(figure, ["time [s]", chart.label]);
    this.chart = chart;
    const key = make("div", figure);
    key.className = "key";
    for (const curve of chart.curves) {
      const entry = make("span", key);
      const line = make("i", entry);
      line.style.borderTopColor = curve.color;
      line.style.borderTopStyle = curve.dash ? "dashed" : "solid";
      entry.append(curve.name);
    }
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.seek(event);
    });
    this.canvas.addEventListener("pointermove", (event) => event.buttons && this.seek(event));
  }
  seek(event) {
    const { left, right } = this.frame;
    pause();
    show(Math.round(((event.offsetX - left) / (right - left)) * last));
  }
  draw() {
    const { chart } = this, end = film.times[last];
    this.open(this.canvas.clientWidth, 170, [0, end], chart.range);
    this.inside((pen) => {
      for (const curve of chart.curves) this.line(pen, curve);
      pen.strokeStyle = "#222";
      pen.lineWidth = 1;
      pen.setLineDash([]);
      pen.beginPath();
      pen.moveTo(this.toX(film.times[now]), this.frame.top);
      pen.lineTo(this.toX(film.times[now]), this.frame.bottom);
      pen.stroke();
    });
  }
  line(pen, { values, color, dash, end }) {
    const steps = values.length < film.nodes.length;
    pen.strokeStyle = color;
    pen.lineWidth = 1.6;
    pen.setLineDash(DASHES[dash]);
    pen.beginPath();
    values.forEach((value, k) => {
      if (value === null) return;
      pen.lineTo(this.toX(film.nodes[k]), this.toY(value));
      if (steps) pen.lineTo(this.toX(film.nodes[k + 1]), this.toY(value));
    });
    if (end !== undefined && end !== null) pen.lineTo(this.toX(film.nodes.at(-1)), this.toY(end));
    pen.stroke();
    pen.setLineDash([]);
  }
}

document.documentElement.style.setProperty("--columns", film.columns);
const plots = [
  ...film.motions.map((motion) => new Picture(byId("motions"), motion)),
  ...film.charts.map((chart) => new Chart(byId("charts"), chart)),
];
byId("caption").textContent = film.caption;
byId("scrub").max = last;
for (const rate of [0.1, 0.25, 0.5, 1, 2, 4]) {
  const choice = make("option", byId("speed"), `${rate} ×`);
  choice.value = rate;
  choice.selected = rate === 1;
}

function show(frame) {
  now = Math.max(0, Math.min(last, frame));
  byId("scrub").value = now;
  byId("clock").value = `t = ${film.times[now].toFixed(2)} s${film.pace}`;
  document.body.dataset.frame = now;
  for (const plot of plots) plot.draw();
}

let playing = null;
function pause() {
  playing = null;
  byId("play").textContent = "▶";
  byId("play").setAttribute("aria-label", "play");
}
function play() {
  const begun = (playing = { time: performance.now(), frame: now < last ? now : 0 });
  byId("play").textContent = "❚❚";
  byId("play").setAttribute("aria-label", "pause");
  const rate = film.fps * byId("speed").value;
  const tick = () => {
    if (playing !== begun) return;
    const frame = begun.frame + Math.floor(((performance.now() - begun.time) / 1000) * rate);
    if (frame !== now) show(frame);
    if (frame >= last) pause();
    else setTimeout(tick, Math.min(200, 500 / rate));
  };
  tick();
}
const step = (by) => { pause(); show(now + by); };

byId("play").addEventListener("click", () => (playing ? pause() : play()));
byId("back").addEventListener("click", () => step(-1));
byId("on").addEventListener("click", () => step(1));
byId("scrub").addEventListener("input", (event) => { pause(); show(Number(event.target.value)); });
byId("speed").addEventListener("change", () => playing && play());
document.addEventListener("keydown", (event) => {
  const act = { " ": () => byId("play").click(), ArrowLeft: () => step(-1), ArrowRight: () => step(1),
    Home: () => step(-now), End: () => step(last) }[event.key];
  if (!act || event.target.tagName === "SELECT") return;
  event.preventDefault();
  act();
});
window.addEventListener("resize", () => show(now));
// A link may name its frame: page.html#12
const asked = () => show(Number.parseInt(location.hash.slice(1), 10) || 0);
window.addEventListener("hashchange", asked);
asked();
