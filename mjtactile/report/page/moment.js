"use strict";
// The moment that is shown: images and membranes by a slider.
const membranes = Array.from(document.querySelectorAll("canvas.membrane"));
const drawMembranes = () => membranes.forEach(drawMembrane);

for (const canvas of membranes) {
  dragged(canvas, (dx, event, dy) => {
    view.yaw += 0.01 * dx;
    view.tilt = Math.min(Math.max(view.tilt + 0.01 * dy, 0), Math.PI / 2);
    drawMembranes();
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    view.zoom = Math.min(Math.max(view.zoom * Math.exp(-0.0015 * event.deltaY), 0.3), 8);
    drawMembranes();
  }, {passive: false});
}

function show(number) {
  if (!data.shots.length) return;
  view.shot = number;
  const shot = data.shots[number];
  $("slider").value = number;
  $("moment").textContent = `${shot.time.toFixed(2)} s`;
  document.querySelectorAll("img.camera").forEach((image, f) => { if (shot.pictures[f]) image.src = shot.pictures[f]; });
  if ($("scene") && shot.scene) $("scene").src = shot.scene;
  drawChart();
  drawMembranes();
}

let playing = null;
function play() {
  $("play").textContent = playing ? "play" : "stop";
  if (playing) { clearInterval(playing); playing = null; return; }
  playing = setInterval(() => show((view.shot + 1) % data.shots.length), 1000 * (END - BEGIN) / data.shots.length);
}

$("slider").addEventListener("input", event => show(Number(event.target.value)));
$("play").addEventListener("click", play);
$("plot").addEventListener("change", event => { view.plot = data.plots[event.target.value]; drawChart(); });
window.addEventListener("resize", () => { drawChart(); drawMembranes(); });
drawChart();
show(data.first);
