"use strict";
// Membranes to turn: painted from the back to the front, without WebGL.
const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

function colourOf(share, light) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), k = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return `rgb(${VIRIDIS[k].map((v, i) => Math.round(light * (v + (at - k) * (VIRIDIS[k + 1][i] - v)))).join(",")})`;
}

function heights(text) {  // mm, from base64 of 16 bit whole numbers, the lower byte first
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  return Array.from(new Int16Array(bytes.buffer), value => value * data.height_unit);
}

function drawMembrane(canvas, finger) {
  const [c, width, height] = prepared(canvas), shot = data.shots[view.shot], estimate = shot.estimates[finger], grid = data.grids[finger];
  c.fillStyle = "#444";
  if (!estimate || !grid) { c.fillText(estimate === null ? "no surface: see the status above" : "no surface", 10, 20); return; }
  const z = heights(estimate.z), nx = grid.x.length, ny = grid.y.length, [low, high] = data.z_range;
  const size = Math.hypot(grid.x[nx - 1] - grid.x[0], grid.y[ny - 1] - grid.y[0]);
  const tall = Math.max(1, Math.round(0.3 * size / Math.max(high - low, 1e-3)));  // heights are drawn larger
  const scale = 0.92 * view.zoom * Math.min(width, 1.2 * height) / size, [sy, cy] = [Math.sin(view.yaw), Math.cos(view.yaw)];
  const [st, ct] = [Math.sin(view.tilt), Math.cos(view.tilt)];
  const seen = (px, py, pz) => {  // pixels to the right and down, and how near
    const across = px * cy - py * sy, along = px * sy + py * cy, up = tall * (pz - (low + high) / 2);
    return [width / 2 + scale * across, 0.42 * height - scale * (along * st + up * ct), up * st - along * ct];
  };
  const at = (i, j) => seen(grid.x[i], grid.y[j], z[j * nx + i]), items = [];
  for (let j = 0; j + 1 < ny; j++) {
    for (let i = 0; i + 1 < nx; i++) {
      const corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], k = j * nx + i;
      const [ax, ay] = [tall * (z[k + 1] - z[k]) / (grid.x[1] - grid.x[0]), tall * (z[k + nx] - z[k]) / (grid.y[1] - grid.y[0])];
      const light = 0.55 + 0.45 * (1 - 0.5 * ax + 0.35 * ay) / Math.hypot(1, ax, ay) / 1.18;
      const mean = (z[k] + z[k + 1] + z[k + nx] + z[k + nx + 1]) / 4;
      items.push([corners.reduce((sum, corner) => sum + corner[2], 0) / 4, corners,
                  colourOf((mean - low) / (high - low), Math.max(light, 0.25))]);
    }
  }
  const reach = 0.25 * size / data.arrow_unit;  // mm drawn for a pascal
  for (const [x, y, foot, sx, sy_, sz] of estimate.arrows) {
    const tip = seen(x + reach * sx, y + reach * sy_, foot + reach * sz / tall), start = seen(x, y, foot);
    items.push([Math.max(start[2], tip[2]) + 0.5, [start, tip], null]);
  }
  items.sort((a, b) => a[0] - b[0]);
  for (const [, points, colour] of items) {
    if (colour === null) { arrow(c, ...points); continue; }
    c.fillStyle = c.strokeStyle = colour;
    c.lineWidth = 0.6;
    c.beginPath();
    for (const [px, py] of points) c.lineTo(px, py);
    c.closePath();
    c.fill();
    c.stroke();
  }
  const lines = (all, colour, wide) => all.forEach(one => line(c, one.map(([x, y, up]) => seen(x, y, up)), colour, wide));
  lines(estimate.true, "#e07b00", 2.2);  // ground truth
  lines(estimate.shape, "#1b1b1b", 1.4);  // estimate: border and shape
  if (estimate.true.length) {
    c.fillStyle = "#b86500";
    c.fillText("contact shape: ground truth (orange), estimated (black)", 8, 30);
  }
  c.fillStyle = "#222";
  c.fillText(`${estimate.text}; heights from ${low.toFixed(1)} to ${high.toFixed(1)} mm` + (tall > 1 ? `, heights times ${tall}` : ""),
             8, height - 24);
  c.fillStyle = "#c0221c";
  if (estimate.arrows.length) {
    line(c, [[8, height - 9], [8 + scale * 0.25 * size, height - 9]], "#c0221c", 2);
    c.fillText(`${data.arrow_unit / 1000} kPa of traction, sign inverted`, 14 + scale * 0.25 * size, height - 5);
  }
}

function arrow(c, [ax, ay], [bx, by]) {
  const angle = Math.atan2(by - ay, bx - ax), head = Math.min(5, 0.4 * Math.hypot(bx - ax, by - ay));
  const side = turn => [bx - head * Math.cos(angle + turn), by - head * Math.sin(angle + turn)];
  line(c, [[ax, ay], [bx, by]], "#c0221c", 1.1);
  line(c, [side(0.5), [bx, by], side(-0.5)], "#c0221c", 1.1);
}

