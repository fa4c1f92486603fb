"""A page opened in a real browser: what it drew, what it complained of, and whether it fits."""

import gzip
import json
import re
import shutil
import subprocess
from base64 import b64decode
from html import unescape
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_PROBE_HEAD = """<script>
window.problems = [];
window.addEventListener("error", e => window.problems.push(String(e.message)));
for (const level of ["error", "warn"]) {
  const old = console[level]; console[level] = (...a) => { window.problems.push(a.join(" ")); old.apply(console, a); };
}
</script>"""
_PROBE_TAIL = """<script>
window.addEventListener("load", () => setTimeout(() => {
  %s
  setTimeout(() => parent.postMessage(JSON.stringify({
    problems: window.problems, width: window.innerWidth, scroll: document.documentElement.scrollWidth,
    drawn: [...document.querySelectorAll(".plot")].map(p => [
      p.id, p.dataset.drawn, p.querySelectorAll(".scatterlayer .trace").length, p.getBoundingClientRect().right]),
  }), "*"), 1500);
}, 1500));
</script>"""


def opened(html: str, width: int, folder: Path, action: str) -> dict[str, Any]:
    """What a page says of itself in a frame `width` pixels wide, after the JavaScript `action` was done."""
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    tail = _PROBE_TAIL % action
    (folder / "page.html").write_text(
        html.replace("<head>", "<head>" + _PROBE_HEAD).replace("</body>", tail + "</body>")
    )
    # A window cannot be as narrow as a phone, a frame can.
    (folder / "frame.html").write_text(
        '<!doctype html><body><pre id="told"></pre><script>'
        'window.onmessage = e => document.getElementById("told").textContent = e.data</script>'
        f'<iframe src="page.html" width="{width}" height="844" style="border:0"></iframe></body>'
    )
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]
    flags += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000", "--window-size=1400,900"]
    command = [CHROMIUM, *flags, "--dump-dom", f"file://{folder / 'frame.html'}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="told">(.+?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-2000:]
    told: dict[str, Any] = json.loads(unescape(found[1]))
    assert told["width"] == width
    return told


def unpacked(html: str, name: str) -> str:
    """What stands compressed in a page under a name."""
    found = re.search(rf'<script id="{name}" type="application/gzip">(.*?)</script>', html)
    assert found, f"the page has no {name}"
    return gzip.decompress(b64decode(found[1])).decode()
