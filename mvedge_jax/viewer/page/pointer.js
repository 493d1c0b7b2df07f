"use strict";
// Pointer and wheel: click to choose, drag to turn, move to look around.

function listen(viewer) {
  const { state, stage, canvas } = viewer, [rows, columns, height, width] = viewer.data.shape;
  let last = null;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * canvas.width - 0.5, ((event.clientY - box.top) / box.height) * canvas.height - 0.5];
  };
  const step = (value, most, count) => Math.min(Math.max((value / most) * 2 - 1, -1), 1) * ((count - 1) / 2);
  stage.addEventListener("pointerdown", (event) => {
    last = place(event);
    stage.setPointerCapture(event.pointerId);
    const [x, y] = last.map(Math.round);
    if ("FE".includes(state.mode) && x >= 0 && y >= 0 && x < width && y < height) viewer.click(x, y);
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => { last = null; });
  stage.addEventListener("pointermove", (event) => {
    const now = place(event);
    if (state.mode === "G" && last) {
      viewer.set("yaw", state.yaw + (now[0] - last[0]) * 0.006);
      viewer.set("pitch", Math.min(Math.max(state.pitch + (now[1] - last[1]) * 0.006, -1.5), 1.5));
      last = now;
    } else if (state.follow && "FE".includes(state.mode)) {
      if (rows > 1) viewer.set("v", step(now[1], height, rows));
      if (columns > 1) viewer.set("u", step(now[0], width, columns));
    }
  });
  stage.addEventListener("wheel", (event) => {
    if (state.mode !== "G") return;
    event.preventDefault();
    viewer.set("distance", Math.min(Math.max(state.distance * Math.exp(event.deltaY * 0.001), 0.1), 40));
  }, { passive: false });
  canvas.addEventListener("webglcontextlost", () => viewer.say("The graphics card has dropped the page: reload it."));
}
