// What stands compressed in the page: gzip in base64, a third of its size.
window.unpacked = function (id) {
  const packed = atob(document.getElementById(id).textContent);
  const bytes = Uint8Array.from(packed, function (c) { return c.charCodeAt(0); });
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
};
// Plotly, as soon as it is there.
window.drawing = (async function () {
  if (!window.DecompressionStream) {
    document.querySelectorAll(".plot").forEach(function (plot) {
      plot.textContent = "This figure needs a browser of 2023 or later.";
    });
    return new Promise(function () {});
  }
  const code = document.createElement("script");
  code.textContent = await window.unpacked("plotly");
  document.head.append(code);
})();
