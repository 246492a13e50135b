"""The offline page of a view: the same bytes each time, a bounded size, and nothing that runs a name."""

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import rich.console
from PIL import Image

from alula.stages.show.drawing.content import Lines, segments_of
from alula.stages.show.viewing import light
from alula.stages.show.viewing import page as pages
from alula.stages.show.viewing.compose import Shown, content_of
from alula.stages.show.viewing.draw import GAP_S, Span
from alula.stages.show.viewing.light import fewer
from alula.stages.show.viewing.page import page, within
from alula.stages.show.viewing.plots import flight_data
from support.flights.viewed_runs import run_of
from support.scenes.fabricate import box, make_cover, make_scene, make_trial


def facts(text):
    return json.loads(re.search(r'id="alula-data">(.*?)</script>', text, re.DOTALL)[1])


def test_the_same_content_gives_the_same_page():
    shown = Shown(title="t", scenes=[("s", make_scene(50))], runs=[run_of([make_trial(0)])])
    assert page(content_of(shown)) == page(content_of(shown))


def test_flights_follow_one_another_on_the_timeline():
    shown = Shown(title="t", runs=[run_of([make_trial(0), make_trial(1, "stuck")])])
    first, second = facts(page(content_of(shown)))["flights"]
    assert (first["outcome"], first["begin"]) == ("stuck", 0)
    assert first["end"] == pytest.approx(5, abs=1e-3)
    assert second["begin"] == pytest.approx(5 + GAP_S, abs=1e-3)


@pytest.mark.slow
def test_a_page_is_bounded_by_fewer_gaussians_and_has_a_light_one(monkeypatch):
    for module in (pages, light):
        monkeypatch.setattr(module, "LIGHT_GAUSSIANS", 500)
    scene = make_scene(40_000)
    make = lambda most: content_of(Shown(title="t", scenes=[("s", scene)]), most_gaussians=most)  # noqa: E731
    whole, content = within(make)
    assert content.gaussians == 40_000
    assert re.search(r'alulaDraws\("[\w+/=]+","(499|500) of 40,000 Gaussians, [\w ]+","', whole)
    text, content = within(make, maximum=1_500_000)
    assert len(text) <= 1_500_000
    assert 5_000 < content.gaussians < 40_000
    text, content = within(make, maximum=1_500_000, gaussians=40_000)
    assert len(text) > 1_500_000
    assert content.gaussians == 40_000  # as asked for
    few, content = within(make, gaussians=400)
    assert content.gaussians <= 400
    assert "EMBED_DATA__=alulaDraws(" not in few


def test_a_page_has_a_small_picture_that_is_hidden_at_first():
    content = content_of(Shown(title="STILL TITLE", scenes=[("s", make_scene(500))]))
    text = page(content)
    assert '<figure id="alula-still" hidden><img ' in text
    assert "<summary>STILL TITLE</summary>" in text
    data = base64.b64decode(re.search(r'src="data:image/webp;base64,([^"]+)"', text)[1])
    with Image.open(io.BytesIO(data)) as image:
        assert np.ptp(np.asarray(image.convert("L"))) > 50
    assert len(data) < 150_000


def test_a_page_is_written_without_a_word_of_the_recorder(monkeypatch):
    console = rich.console.Console(file=io.StringIO())  # a notebook's shows what it gets, whatever stdout is
    monkeypatch.setattr(rich, "_console", console)
    page(content_of(Shown(title="t", scenes=[("s", make_scene(5))])))
    assert console.file.getvalue() == ""
    console.print("later")
    assert console.file.getvalue() == "later\n"


def test_names_run_nothing_and_the_policy_blocks_requests():
    evil = "</script><script>alert(1)</script>"
    shown = Shown(title=evil, runs=[run_of([make_trial(0)], evil), run_of([make_trial(0)], "b")])
    text = page(content_of(shown))
    assert evil not in text
    assert facts(text)["title"] == evil
    assert 'http-equiv="Content-Security-Policy" content="default-src \'none\'' in text
    assert text.count("<title>") == 1


def test_curves_keep_their_peaks_and_gaps():
    (play,) = content_of(Shown(title="t", runs=[run_of([make_trial(0)])])).plays
    value = np.zeros(5000)
    value[1234], value[4000] = 7.0, np.nan
    long = replace(play.series[0], time_s=np.linspace(0, 5, 5000), value=value)
    (data,) = flight_data([replace(play, series=(long,))], [Span(0.0, 5.0)])
    (curve,) = data["plots"][0]["curves"]
    assert len(curve["v"]) <= 302
    assert max(v for v in curve["v"] if v is not None) == 7.0


def test_a_light_page_keeps_the_ends_of_paths_and_the_longest_edges():
    points = np.cumsum(np.random.default_rng(5).normal(size=(2, 101, 3)), axis=1)
    paths = np.concatenate([segments_of(one) for one in points])
    few = fewer(paths, 0.1)
    assert len(few) == 20
    for k, one in enumerate(points):
        assert np.array_equal(few[10 * k, 0], one[0])
        assert np.array_equal(few[10 * k + 9, 1], one[-1])
    assert np.array_equal(few[:9, 1], few[1:10, 0])
    edges = np.zeros((50, 2, 3))
    edges[:, 0, 1], edges[:, 1, 1] = np.arange(50), np.arange(50)
    edges[:, 1, 0] = 1 + np.arange(50) % 7
    assert sorted(fewer(edges, 0.28)[:, 1, 0].tolist()) == [6.0] * 7 + [7.0] * 7


def test_a_page_with_many_edges_has_a_light_one_too():
    hulls = [box((3 * i, 0, 0), (3 * i + 2, 2, 2)) for i in range(400)]
    make = lambda most: content_of(  # noqa: E731
        Shown(title="t", covers=[("c", make_cover(hulls))]), most_gaussians=most
    )
    whole = make(0)
    assert sum(len(p.segments) for p in whole.parts if isinstance(p, Lines)) == 400 * 12
    found = light.lightened(whole, make)
    kept = sum(len(p.segments) for p in found.parts if isinstance(p, Lines))
    assert kept == pytest.approx(light.LIGHT_SEGMENTS, rel=0.01)
    assert 'alulaDraws("' in within(make)[0]
