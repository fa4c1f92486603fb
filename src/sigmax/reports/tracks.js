document.addEventListener("DOMContentLoaded", async function () {
  "use strict";
  await window.drawing;
  const data = JSON.parse(await window.unpacked("tracks"));
  const map = document.getElementById("map"), slider = document.getElementById("moment");
  const play = document.getElementById("play"), told = document.getElementById("moment-told");
  const font = { family: "system-ui, -apple-system, 'Segoe UI', Roboto, Arial, sans-serif", size: 12, color: "#1f2933" };
  const turn = Array.from({ length: 33 }, function (_, i) { return i * Math.PI / 16; });
  const narrow = window.innerWidth <= 620;

  // The last place of ascending times that is not after t, or -1.
  function last(times, t) {
    let low = 0, high = times.length;
    while (low < high) { const middle = (low + high) >> 1; if (times[middle] <= t) { low = middle + 1; } else { high = middle; } }
    return low - 1;
  }
  function line(name, colour, width, opacity) {
    return { type: "scatter", mode: "lines", name: name, x: [], y: [], line: { color: colour, width: width }, opacity: opacity, hoverinfo: "name" };
  }
  function upTo(track, t, tail) {
    const end = last(track.t, t), start = Math.max(0, last(track.t, t - tail));
    return [track.x.slice(start, end + 1), track.y.slice(start, end + 1)];
  }
  function show(t) {
    const traces = [];
    data.truth.forEach(function (target) {
      const all = line(target.name, "#9aa5b1", 4, 0.45);
      all.x = target.x; all.y = target.y; traces.push(all);
      const k = last(target.t, t);
      traces.push({ type: "scatter", mode: "markers", name: target.name + " now", showlegend: false, hoverinfo: "name", x: k < 0 ? [] : [target.x[k]], y: k < 0 ? [] : [target.y[k]], marker: { symbol: "diamond-open", size: 12, color: "#6b7785", line: { width: 2 } } });
    });
    data.plots.forEach(function (sensor) {
      const end = last(sensor.t, t) + 1, start = last(sensor.t, t - data.memory) + 1;
      traces.push({ type: "scatter", mode: "markers", name: "plots of " + sensor.name, x: sensor.x.slice(start, end), y: sensor.y.slice(start, end), marker: { size: 5, color: sensor.colour, opacity: 0.6 }, hoverinfo: "name" });
    });
    const ellipses = { type: "scatter", mode: "lines", name: "2σ", x: [], y: [], line: { color: "#1f2933", width: 1.2 }, hoverinfo: "skip" };
    const names = { type: "scatter", mode: "text", x: [], y: [], text: [], textposition: "top right", textfont: { size: 11, color: "#1f2933" }, showlegend: false, hoverinfo: "skip" };
    data.tracks.forEach(function (track) {
      if (t < track.t[0]) { return; }
      const gone = t > track.t[track.t.length - 1] + data.memory;
      const drawn = line("track " + track.id, track.colour, gone ? 1 : 2.2, gone ? 0.25 : 1), part = upTo(track, t, gone ? 1e12 : data.tail);
      drawn.x = part[0]; drawn.y = part[1]; drawn.showlegend = false; traces.push(drawn);
      if (gone) { return; }
      const k = last(track.t, t), e = track.e[k], c = Math.cos(e[2]), s = Math.sin(e[2]);
      turn.forEach(function (a) {
        const u = 2 * e[0] * Math.cos(a), v = 2 * e[1] * Math.sin(a);
        ellipses.x.push(track.x[k] + c * u - s * v); ellipses.y.push(track.y[k] + s * u + c * v);
      });
      ellipses.x.push(null); ellipses.y.push(null);
      names.x.push(track.x[k]); names.y.push(track.y[k]); names.text.push(String(track.id));
    });
    traces.push(ellipses, names);
    const axis = { gridcolor: "#edf0f2", linecolor: "#c6ccd2", zerolinecolor: "#c6ccd2", automargin: true };
    const layout = {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "#ffffff", font: font, autosize: true, uirevision: "kept", hovermode: "closest",
      margin: { l: 8, r: 10, t: 24, b: 8 }, height: narrow ? 460 : 600, legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" },
      xaxis: Object.assign({ title: { text: data.axes[0] }, range: data.ranges[0] }, axis),
      yaxis: Object.assign({ title: { text: data.axes[1] }, range: data.ranges[1], scaleanchor: "x", scaleratio: 1 }, axis)
    };
    told.textContent = t.toFixed(1) + " s";
    Plotly.react(map, traces, layout, { responsive: true, displayModeBar: false }).then(function () { map.dataset.drawn = "map"; });
  }
  slider.addEventListener("input", function () { show(Number(slider.value)); });
  let running = null;
  play.addEventListener("click", function () {
    if (running) { window.clearInterval(running); running = null; play.textContent = "Play"; return; }
    play.textContent = "Stop";
    if (Number(slider.value) >= Number(slider.max)) { slider.value = slider.min; }
    const step = (Number(slider.max) - Number(slider.min)) / 300;
    running = window.setInterval(function () {
      slider.value = Number(slider.value) + step; show(Number(slider.value));
      if (Number(slider.value) >= Number(slider.max)) { play.click(); }
    }, 80);
  });
  show(Number(slider.value));
});
