"""Names that come from outside stay text: in every place of every page, and in a real browser."""

import copy
import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp

import sigmax
from sigmax.reports import score
from sigmax.reports.comparison import page as study_page
from sigmax.reports.comparison.pictures import pictures
from sigmax.reports.comparison.standing import standings
from sigmax.reports.document import choices, document, place, section, table
from sigmax.reports.page import page
from sigmax.studies import Study, compare
from tests.browser import opened
from tests.own_records import tracked_radar

# What ends an attribute, an element, a script or a comment, and what runs where it is taken for markup.
HOSTILE = (
    """"'><script>problems.push('ran %s')</script><img src=x onerror=problems.push('loaded')><!--<script>$x_{ {{%s}}"""
)


def hostile(what: str) -> str:
    """A name of something, told from others."""
    return HOSTILE.replace("%s", what)


def assert_harmless(html: str, folder: Path) -> None:
    """Nothing of a name is markup: no element more than the page has, and none in the browser."""
    assert "<!--<script" not in html
    without = re.sub(r"<script[ >].*?</script>", "", html, flags=re.S)
    assert "<script" not in without
    assert "<img" not in without
    script = """
    if (document.images.length) window.problems.push("images");
    for (const s of document.querySelectorAll("select[data-choice]")) {
      s.selectedIndex = s.options.length - 1; s.dispatchEvent(new Event("change")); }"""
    seen = opened(html, 1200, folder, script)
    assert seen["problems"] == []
    assert seen["drawn"]


def hostile_study() -> Study:
    model = sigmax.Model(
        motion=lambda x, dt: x,
        sensor={hostile("sensor"): lambda x: x[:1], "b": lambda x: jnp.stack([x[1]])},
        Q=[0.1, 0.1],
        R={hostile("sensor"): [1.0], "b": [1.0]},
        state=(hostile("one"), hostile("two")),
    )
    return Study(
        name="names" + hostile("study"),
        model=model,
        prior=sigmax.Gaussian([0.0, 0.0], [1.0, 1.0]),
        steps=4,
        title=hostile("title"),
        units=(hostile("unit"), "rad" + hostile("unit")),
        about=(hostile("about"),),
        look=(1, 4),
    )


def test_names_of_a_study_are_text(tmp_path: Path) -> None:
    study = hostile_study()
    filters = {hostile("filter"): sigmax.get("EKF"), hostile("other"): sigmax.get("SRCKFB")}
    c = compare(study, filters, runs=64)
    c = c._replace(failures={hostile("failed"): hostile("failure")}, notes=(hostile("note"),))
    c = c._replace(filters=c.filters | {hostile("failed"): sigmax.get("UKF")}, no_bound=hostile("bound"))
    assert_harmless(study_page([c]), tmp_path)
    assert_harmless(study_page([c, c]), tmp_path)
    # Formulas of matplotlib are names too.
    pictures(tmp_path / "figures", c, standings(c))
    for picture in (tmp_path / "figures").glob("*.svg"):
        assert "<script" not in re.sub(r"<!--.*?-->", "", picture.read_text(), flags=re.S)


def test_names_of_a_record_are_text(tmp_path: Path) -> None:
    record, found, _ = tracked_radar()
    model = copy.copy(record.model)
    names = tuple(hostile(f"state {k}") for k in range(model.size))
    model.components = dataclasses.replace(model.components, numbers=names, deviations=names)
    many = {
        "name": hostile("record"),
        "title": hostile("title"),
        "tracks": tuple(hostile(f"track {k}") for k in range(len(record.tracks))),
        "source": hostile("source"),
        "licence": hostile("licence"),
        "notes": (hostile("note"),),
        "landmarks": {hostile("landmark"): (0.0, 0.0)},
        "model": model,
    }
    named = dataclasses.replace(record, **many)
    trial = found.trial._replace(name=hostile("trial"))
    worked, failed = (
        dataclasses.replace(found, trial=trial),
        dataclasses.replace(found, trial=trial, result=None, failure=hostile("failure")),
    )
    scores = [score(named, worked), score(named, failed)]
    scores = [dataclasses.replace(s, label=hostile("label"), constants={}) for s in scores]
    assert_harmless(page(named, [worked, failed], scores), tmp_path)


def test_the_parts_of_a_page_take_no_markup(tmp_path: Path) -> None:
    figure = {"data": [{"x": [1], "y": [1], "name": "a"}], "layout": {"title": hostile("figure"), "yaxis": {}}}
    body = choices(("which", hostile("choice"), [(hostile("value"), hostile("option"))], "")) + place("a", "a")
    rows = table([hostile("head")], [["cell"]])
    html = document(hostile("title"), hostile("about"), [section("A", "", body + rows)], {"a": figure})
    assert_harmless(html, tmp_path)
