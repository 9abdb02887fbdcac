"use strict";
// A surface to turn: painted from the back to the front, without WebGL.
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("solid"), hint = document.getElementById("readout");
const view = {yaw: 0.6, tilt: 0.35, zoom: 1, mode: "stiffness"};
const middle = [0, 1, 2].map(k => (Math.max(...data.vertices.map(p => p[k])) + Math.min(...data.vertices.map(p => p[k]))) / 2);
const radius = Math.max(...data.vertices.map(p => Math.hypot(...p.map((value, k) => value - middle[k]))));
const LIGHT = [-0.4, 0.5, 0.77];

function rotated([x, y, z]) {  // to the right, up, towards the reader
  const [sy, cy, st, ct] = [Math.sin(view.yaw), Math.cos(view.yaw), Math.sin(view.tilt), Math.cos(view.tilt)];
  const across = x * cy - y * sy, along = x * sy + y * cy;
  return [across, z * ct + along * st, z * st - along * ct];
}

function draw() {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const c = canvas.getContext("2d");
  c.scale(ratio, ratio);
  const scale = 0.46 * view.zoom * Math.min(width, height) / radius;
  const place = p => {
    const [x, y, z] = rotated(p.map((value, k) => value - middle[k]));
    return [width / 2 + scale * x, height / 2 - scale * y, z];
  };
  const points = data.vertices.map(place), colours = data.colours[view.mode], items = [];
  for (const [i, j, k] of data.triangles) {
    const [a, b, d] = [points[i], points[j], points[k]];
    if ((b[0] - a[0]) * (d[1] - a[1]) - (b[1] - a[1]) * (d[0] - a[0]) > 0) continue;  // seen from behind
    const normal = rotated([0, 1, 2].map(m => data.normals[i][m] + data.normals[j][m] + data.normals[k][m]));
    const light = 0.5 + 0.5 * Math.max(0, normal.reduce((sum, value, m) => sum + value * LIGHT[m], 0)) / Math.hypot(...normal);
    const mixed = [0, 1, 2].map(m => Math.round(light * (colours[i][m] + colours[j][m] + colours[k][m]) / 3));
    items.push([a[2] + b[2] + d[2], [a, b, d], `rgb(${mixed.join(",")})`]);
  }
  items.sort((one, other) => one[0] - other[0]);
  for (const [, corners, colour] of items) {
    c.fillStyle = c.strokeStyle = colour;
    c.lineWidth = 0.7;
    c.beginPath();
    for (const [x, y] of corners) c.lineTo(x, y);
    c.closePath();
    c.fill();
    c.stroke();
  }
  data.touched.forEach((touch, number) => {
    const [x, y] = place(touch.place), facing = rotated(touch.normal)[2] > 0;
    if (!facing) return;
    c.fillStyle = "#111";
    c.beginPath();
    c.arc(x, y, 2.5, 0, 2 * Math.PI);
    c.fill();
    c.fillText(`${number + 1}`, x + 4, y - 4);
  });
  c.strokeStyle = c.fillStyle = "#222";
  c.lineWidth = 2;
  c.beginPath();
  c.moveTo(12, height - 12);
  c.lineTo(12 + 10 * scale, height - 12);
  c.stroke();
  c.fillText("10 mm", 14, height - 17);
  hint.textContent = data.words[view.mode];
}

let last = null;
canvas.addEventListener("pointerdown", event => { last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
canvas.addEventListener("pointermove", event => {
  if (!last) return;
  view.yaw += 0.01 * (event.clientX - last[0]);
  view.tilt = Math.min(Math.max(view.tilt + 0.01 * (event.clientY - last[1]), -Math.PI / 2), Math.PI / 2);
  last = [event.clientX, event.clientY];
  draw();
});
canvas.addEventListener("pointerup", () => { last = null; });
canvas.addEventListener("wheel", event => {
  event.preventDefault();
  view.zoom = Math.min(Math.max(view.zoom * Math.exp(-0.0015 * event.deltaY), 0.3), 8);
  draw();
}, {passive: false});
document.getElementById("mode").addEventListener("change", event => { view.mode = event.target.value; draw(); });
window.addEventListener("resize", draw);
draw();
