(async function () {
  "use strict";
  await window.drawing;
  const figures = JSON.parse(await window.unpacked("figures"));
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const narrow = function () { return window.innerWidth <= 620; };
  const font = { family: "system-ui, -apple-system, 'Segoe UI', Roboto, Arial, sans-serif", size: 12, color: "#1f2933" };
  const axis = { gridcolor: "#edf0f2", linecolor: "#c6ccd2", zerolinecolor: "#c6ccd2", ticks: "outside", tickcolor: "#c6ccd2", ticklen: 4, automargin: true };
  const config = { responsive: true, displayModeBar: false };

  function layoutOf(figure) {
    const layout = Object.assign({
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "#ffffff", font: font, autosize: true,
      margin: { l: 8, r: 10, t: 24, b: 8 }, hovermode: "closest",
      // On a touch screen a finger on a figure scrolls the page.
      dragmode: touch ? false : "zoom",
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1.02, yanchor: "bottom", font: { size: 12 } }
    }, figure.layout);
    Object.keys(layout).filter(function (key) { return /^[xy]axis/.test(key); }).forEach(function (key) {
      layout[key] = Object.assign({}, axis, layout[key]);
    });
    if (narrow() && layout.yaxis.scaleanchor) { layout.height = Math.min(layout.height, 460); }
    return layout;
  }

  function draw(element) {
    const section = element.closest("section");
    const name = element.dataset.figure.replace(/\{(\w+)\}/g, function (whole, choice) {
      return section.querySelector('select[data-choice="' + choice + '"]').value;
    });
    const figure = figures[name];
    if (!figure) { return; }
    Plotly.react(element, figure.data, layoutOf(figure), config).then(function () { element.dataset.drawn = name; });
  }

  document.querySelectorAll(".plot").forEach(draw);
  document.querySelectorAll("select[data-choice]").forEach(function (select) {
    select.addEventListener("change", function () { select.closest("section").querySelectorAll(".plot").forEach(draw); });
  });
})();
