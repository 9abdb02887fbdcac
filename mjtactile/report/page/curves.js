"use strict";
// Curves to zoom and read off. `data` is what mjtactile/report/page/data.py wrote; membranes.js and moment.js go on from here.
const $ = id => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const LEFT = 56, RIGHT = 20, TOP = 22, BOTTOM = 26;
const BEGIN = data.time[0], END = Math.max(data.time[data.time.length - 1], BEGIN + 1e-3);
const SHORTEST = Math.min(0.05, END - BEGIN);  // s, the closest look
const view = {plot: data.plots[0], from: BEGIN, to: END, pointer: null, shot: 0, yaw: -0.6, tilt: 0.75, zoom: 1};

function lastBefore(values, value) {  // index of the last of rising `values` that is not above `value`
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= value) low = middle; else high = middle - 1;
  }
  return low;
}

function prepared(canvas) {  // its context in CSS pixels, cleared, and its size
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(box.width * ratio);
  canvas.height = Math.round(box.height * ratio);
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  c.font = "12px sans-serif";
  return [c, box.width, box.height];
}

function ticks(low, high, most) {  // round numbers from `low` to `high`
  const least = (high - low) / most, decade = 10 ** Math.floor(Math.log10(least));
  const step = decade * [1, 2, 5, 10].find(k => k * decade >= least);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found.map(value => [value, value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))]);
}

const chart = $("chart");
const timeAt = pixel => view.from + (pixel - LEFT) / (chart.clientWidth - LEFT - RIGHT) * (view.to - view.from);

function shownRange(first, last) {  // of the values of the plot
  let low = 0, high = -Infinity;
  for (const one of view.plot.series) {
    for (let i = first; i <= last; i++) {
      if (one.y[i] === null) continue;
      low = Math.min(low, one.y[i]);
      high = Math.max(high, one.y[i]);
    }
  }
  if (!(high > low)) high = low + 1;
  for (const [value] of view.plot.lines) if (value > high && value < 2.5 * high) high = value;
  const margin = 0.12 * (high - low);
  return [low < 0 ? low - margin : low - 0.3 * margin, high + margin];
}

function drawChart() {
  const [c, width, height] = prepared(chart), {plot, from, to} = view;
  const first = Math.max(0, lastBefore(data.time, from)), last = Math.min(data.time.length - 1, lastBefore(data.time, to) + 1);
  const [low, high] = shownRange(first, last);
  const x = t => LEFT + (t - from) / (to - from) * (width - LEFT - RIGHT);
  const y = v => TOP + (high - v) / (high - low) * (height - TOP - BOTTOM);
  chart.shown = {low, high, from, to};
  c.save();
  c.beginPath();
  c.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM);
  c.clip();
  for (const [name, begin, end, colour] of data.phases) {
    c.fillStyle = colour;
    c.fillRect(x(begin), TOP, x(end) - x(begin), height - TOP - BOTTOM);
    c.fillStyle = "#444";
    const middle = (x(Math.max(begin, from)) + x(Math.min(end, to))) / 2;
    if (c.measureText(name).width < x(Math.min(end, to)) - x(Math.max(begin, from))) {
      c.textAlign = "center";
      c.fillText(name, middle, TOP - 7);
    }
  }
  c.textAlign = "left";
  for (const [value, word] of ticks(low, high, height / 40)) line(c, [[LEFT, y(value)], [width, y(value)]], "#00000016", 1);
  for (const [value, word] of plot.lines) {
    line(c, [[LEFT, y(value)], [width, y(value)]], "#b00020", 1.4);
    c.fillStyle = "#b00020";
    c.fillText(value > high ? `${word} \u2191` : word, LEFT + 6, Math.max(y(value) - 5, TOP + 14));
  }
  for (const one of plot.series) {
    for (const [a, b] of runs(one.y, first, last)) {
      const points = [];
      for (let i = a; i <= b; i++) points.push([x(data.time[i]), y(one.y[i]), one.sd ? y(2 * one.sd[i]) - y(0) : 0]);
      if (one.sd) band(c, points, one.colour);
      line(c, points, one.colour, one.dash ? 1.3 : 1.9, one.dash ? [5, 3] : []);
    }
  }
  if (data.shots.length) line(c, [[x(data.shots[view.shot].time), TOP], [x(data.shots[view.shot].time), height]], "#444", 1, [2, 3]);
  if (view.pointer !== null) line(c, [[x(view.pointer), TOP], [x(view.pointer), height]], "#888", 1);
  legend(c, plot.series, width - RIGHT, TOP + 14);
  c.restore();
  c.fillStyle = "#222";
  c.textAlign = "right";
  for (const [value, word] of ticks(low, high, height / 40)) c.fillText(word, LEFT - 5, y(value) + 4);
  c.textAlign = "center";
  for (const [value, word] of ticks(from, to, width / 90)) c.fillText(`${word} s`, x(value), height - 8);
  $("readout").textContent = readout(view.pointer === null && data.shots.length ? data.shots[view.shot].time : view.pointer);
}

function legend(c, series, right, top) {  // a line as it is drawn, and what it is called
  const widest = Math.max(0, ...series.map(one => c.measureText(one.name).width));
  c.textAlign = "left";
  series.forEach((one, k) => {
    const left = right - widest - 30, middle = top + 16 * k;
    line(c, [[left, middle - 4], [left + 22, middle - 4]], one.colour, 2, one.dash ? [5, 3] : []);
    c.fillStyle = "#222";
    c.fillText(one.name, left + 28, middle);
  });
}

function line(c, points, colour, width, dash = []) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.setLineDash(dash);
  c.beginPath();
  for (const [px, py] of points) c.lineTo(px, py);
  c.stroke();
  c.setLineDash([]);
}

function band(c, points, colour) {
  c.fillStyle = `${colour}2e`;
  c.beginPath();
  for (const [px, py, half] of points) c.lineTo(px, py - half);
  for (const [px, py, half] of points.slice().reverse()) c.lineTo(px, py + half);
  c.fill();
}

function* runs(values, first, last) {  // stretches of `values` without a gap
  for (let i = first, start = -1; i <= last + 1; i++) {
    const known = i <= last && values[i] !== null;
    if (known && start < 0) start = i;
    if (!known && start >= 0) { yield [start, i - 1]; start = -1; }
  }
}

function readout(time) {  // what was measured then, in words
  if (time === null) return "";
  const i = lastBefore(data.time, time), words = [`${data.time[i].toFixed(2)} s, ${data.phase[i]}`];
  for (const one of view.plot.series) {
    const sd = one.sd && one.sd[i] !== null ? ` \u00b1 ${(2 * one.sd[i]).toFixed(3)}` : "";
    words.push(`${one.name} ${one.y[i] === null ? "unknown" : one.y[i].toFixed(3) + sd}`);
  }
  return `${words.join(";  ")};  ${data.fingers.map((name, f) => `${name} ${data.touch_texts[i][f]}`).join(", ")}`;
}

function look(from, to) {  // show this stretch of time, as far as there is any
  const span = Math.min(Math.max(to - from, SHORTEST), END - BEGIN), start = Math.min(Math.max(from, BEGIN), END - span);
  Object.assign(view, {from: start, to: start + span});
  drawChart();
}

chart.addEventListener("wheel", event => {
  event.preventDefault();
  const at = timeAt(event.offsetX), factor = Math.exp(0.0015 * event.deltaY);
  look(at - (at - view.from) * factor, at + (view.to - at) * factor);
}, {passive: false});
chart.addEventListener("dblclick", () => look(BEGIN, END));
chart.addEventListener("pointerleave", () => { view.pointer = null; drawChart(); });
dragged(chart, (dx, event) => {
  const seconds = dx / (chart.clientWidth - LEFT - RIGHT) * (view.to - view.from);
  look(view.from - seconds, view.to - seconds);
}, event => show(data.shots.length ? nearestShot(timeAt(event.offsetX)) : 0));
chart.addEventListener("pointermove", event => {
  view.pointer = Math.min(Math.max(timeAt(event.offsetX), BEGIN), END);
  drawChart();
});

function dragged(element, drag, click = () => {}) {  // call `drag(dx, event, dy)` while a pointer draws, `click` if it did not
  let far = -1;
  element.addEventListener("pointerdown", event => { far = 0; element.setPointerCapture(event.pointerId); });
  element.addEventListener("pointermove", event => {
    if (far < 0) return;
    far += Math.abs(event.movementX) + Math.abs(event.movementY);
    if (far > 3) drag(event.movementX, event, event.movementY);
  });
  element.addEventListener("pointerup", event => { if (far >= 0 && far <= 3) click(event); far = -1; });
  element.addEventListener("pointercancel", () => { far = -1; });
}

function nearestShot(time) {
  const k = lastBefore(data.shots.map(shot => shot.time), time), next = Math.min(k + 1, data.shots.length - 1);
  return data.shots[next].time - time < time - data.shots[k].time ? next : k;
}

