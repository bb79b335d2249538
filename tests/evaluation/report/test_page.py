from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import metric, provenance


def test_a_page_holds_facts_tables_and_figures_and_escapes_what_is_no_figure(tmp_path):
    rows = [{"name": "trot <fast>", "cells": [cell("1.2", "1.1–1.3", best=True), metric_cell(None)]}]
    sections = [
        {"title": "Speed", "text": "a & b", "table": {"head": ["", "m/s", "m"], "rows": rows}},
        {"title": "Seen", "figure": "<svg></svg>", "details": [{"title": "more", "table": {"head": [], "rows": []}}]},
    ]
    write_page(tmp_path / "report.html", "Robots", [("seed", "3"), ("data", "")], sections)
    page = (tmp_path / "report.html").read_text()
    assert "<h1>Robots</h1>" in page and "<dt>seed</dt><dd>3</dd>" in page and "<dt>data</dt>" not in page
    assert '<td class="best">1.2<small>1.1–1.3</small></td><td>–</td>' in page
    assert "trot &lt;fast&gt;" in page and "a &amp; b" in page and "<svg></svg>" in page
    assert [item.name for item in tmp_path.iterdir()] == ["report.html"]


def test_a_metric_is_shown_with_its_interval_where_it_has_one():
    assert metric_cell(metric(0.01234, (0.01, 0.02), 5, "m"), 1e3, 1) == cell("12.3", "10.0–20.0")
    assert metric_cell(metric(0.5, None, 1, "1"), 100.0, 0, best=True) == cell("50", "", True)


def test_where_figures_come_from_is_told_alike_on_every_page():
    where = provenance({}, seed=4, data_hash="0123456789abcdef", data=["a", "b"])
    facts = dict(origin({**where, "commit": 40 * "c" + "-dirty"}))
    assert facts == {"data": "a, b", "data hash": "0123456789ab", "seed": "4", "commit": 12 * "c" + "-dirty"}
    assert dict(origin({**where, "commit": None}))["commit"] == "installed wheel"
    assert "bundle" in dict(origin(where, hashed="bundle")) and "data hash" not in dict(origin(where, hashed=None))
