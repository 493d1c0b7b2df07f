"""The page in a headless Chromium, with a processor for a graphics card."""

import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from viewer.scenes import FAR, NEAR, disparity, result, square_field

from mvedge_jax.viewer import page, serve

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_CHROMIUM = next((path for path in map(shutil.which, _NAMES) if path), None)
pytestmark = pytest.mark.skipif(
    _CHROMIUM is None, reason=f"no browser is installed; looked for {', '.join(_NAMES)}"
)


@pytest.fixture(scope="module")
def chromium():
    options = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if os.geteuid() == 0:  # root has no sandbox
        options.append("--no-sandbox")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=_CHROMIUM, args=options)
        yield browser
        browser.close()


@pytest.fixture
def look(chromium, tmp_path):
    """Opens a page, and at the end checks that it was quiet and asked nobody for anything."""
    opened = []

    def open_page(html: str, *, url: str | None = None):
        if url is None:
            path = tmp_path / f"{len(opened)}.html"
            path.write_text(html, encoding="utf-8")
            url = path.as_uri()
        tab = chromium.new_page(viewport={"width": 1200, "height": 800})
        said: list[str] = []
        asked: list[str] = []
        tab.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        opened.append((tab, url, said, asked))
        tab.goto(url)
        tab.evaluate("mvedge.ready")
        return tab

    yield open_page
    for tab, url, said, asked in opened:
        tab.close()
        assert said == []
        assert asked == [url]


def _set(tab, **values):
    tab.evaluate(
        "v => { Object.entries(v).forEach(e => mvedge.set(...e)); mvedge.draw(); }", values
    )


def _slide(tab, name, value):
    """As a hand does: the element, not the program."""
    code = "(e, v) => { e.value = v; e.dispatchEvent(new Event('input', {bubbles: true})); }"
    tab.locator(f"input[name={name}]").evaluate(code, str(value))
    tab.evaluate(
        "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )


def _pixel(tab, x, y):
    return np.array(tab.evaluate("([x, y]) => mvedge.pixel(x, y)", [x, y]))[:3]


def _is(color, expected):
    # To linear light and back, and tables of 256 colors.
    return np.abs(color.astype(int) - np.array(expected)).max() <= 2


def _click(tab, x, y):
    box = tab.locator("canvas.picture").bounding_box()
    size = "e => [e.width, e.height]"
    width, height = tab.locator("canvas.picture").evaluate(size)
    across, down = box["width"] / width, box["height"] / height
    tab.mouse.click(box["x"] + (x + 0.5) * across, box["y"] + (y + 0.5) * down)


@pytest.fixture(scope="module")
def html():
    return page(square_field(), result(), quality=100)


@pytest.fixture
def tab(look, html):
    return look(html)


@pytest.mark.parametrize("served", [False, True])
def test_a_file_or_a_server_shows_the_center_view(look, html, served):
    with serve(html, port=0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        tab = look(html, url=server.url if served else None)
        assert _is(_pixel(tab, 34, 24), NEAR)
        assert _is(_pixel(tab, 5, 5), FAR)
        assert tab.evaluate("mvedge.measure(0.2)") > 0
        assert tab.evaluate("mvedge.loaded") > 0
        server.shutdown()
        thread.join()


def test_numbers_arrive_as_they_were(tab, html):
    found = tab.evaluate(
        "text => { const e = document.createElement('script'); e.textContent = text;"
        " return unpack(e).then(d => [...d.maps].map(m => [...(m.error || m.disparity)])); }",
        html.split('id="data">')[1].split("</script>")[0],
    )
    error = np.array(found[0]).reshape(48, 64)
    assert error[0, 0] < -1e8
    np.testing.assert_allclose(error[1:, :8], 0.5, rtol=1e-4)
    np.testing.assert_allclose(error[:, 8:], 0.02, rtol=1e-4)
    np.testing.assert_allclose(np.array(found[1]).reshape(48, 64), disparity(), atol=1e-5)


def test_a_slider_moves_the_near_square(tab):
    """In view (v, u) = (1, 4), two columns to the right, the square is two px to the left."""
    assert _is(_pixel(tab, 43, 20), NEAR)
    _slide(tab, "u", 2)
    assert _is(_pixel(tab, 43, 20), FAR)
    assert _is(_pixel(tab, 22, 20), NEAR)
    _slide(tab, "v", -1)
    assert _is(_pixel(tab, 30, 32), NEAR)
    # Between views: half a step is half a pixel; a pixel inside the square stays what it was.
    _slide(tab, "u", 0.5)
    assert _is(_pixel(tab, 30, 24), NEAR)
    assert _is(_pixel(tab, 46, 24), FAR)


def test_a_click_focuses_at_what_is_seen(tab):
    _click(tab, 34, 24)
    assert tab.evaluate("mvedge.state.focus") == pytest.approx(1, abs=1e-4)
    assert tab.evaluate("mvedge.state.at") == [34, 24]
    assert "disparity 1.000 ± 0.020" in tab.locator(".status").inner_text()
    _click(tab, 5, 5)
    assert tab.evaluate("mvedge.state.focus") == pytest.approx(0, abs=1e-4)
    # From the right the square is seen further left: there is column 24 at 22.
    _set(tab, u=2)
    _click(tab, 22, 20)
    assert tab.evaluate("mvedge.state.focus") == pytest.approx(1, abs=1e-4)
    assert tab.evaluate("mvedge.state.at") == [24, 20]


def test_the_aperture_blurs_what_is_out_of_focus(tab):
    _set(tab, aperture=2, shape="square", focus=1, sharp=0)
    assert _is(_pixel(tab, 26, 20), NEAR)
    _set(tab, focus=0)
    # Three of five columns of views show the square at its second column and one beyond.
    light = (np.array([NEAR, FAR]) / 255.0) ** 2.2
    blend = 255 * ((0.8 * light[0] + 0.2 * light[1]) ** (1 / 2.2))
    assert np.abs(_pixel(tab, 25, 24) - blend).max() < 12
    _set(tab, sharp=1)  # by the map all is in focus
    assert _is(_pixel(tab, 25, 24), NEAR)
    _set(tab, shape="column of views", sharp=0)
    assert _is(_pixel(tab, 25, 24), NEAR)


def test_slices_show_the_views(tab):
    """The EPI of row 24: view u shows the square's left edge at 24 + (2 - u)."""
    _click(tab, 30, 24)
    for u in range(5):
        y = 48 + 4 + 7 * u + 3
        assert _is(_pixel(tab, 24 + 2 - u + 1, y), NEAR)
        assert _is(_pixel(tab, 24 + 2 - u - 2, y), FAR)


def test_overlays_show_the_map(tab):
    seen = []
    for color in ("disparity", "standard error", "difference"):
        _set(tab, color=color, opacity=1)
        seen.append((_pixel(tab, 34, 24), _pixel(tab, 3, 24), _pixel(tab, 12, 24)))
    (near, far, _), (sure, unsure, _), (same, _, _) = seen
    assert _is(near, (253, 231, 37))  # the ends of viridis
    assert _is(far, (68, 1, 84))
    assert np.abs(sure.astype(int) - unsure).max() > 50
    assert same.min() > 230  # the truth itself: white
    _set(tab, color="disparity", u=2)
    assert _is(_pixel(tab, 22, 20), (253, 231, 37))


def test_a_picture_is_hidden_by_what_is_nearer(tab):
    tab.get_by_role("button", name="Edit").click()
    _set(tab, cardDisparity=0.5, cardSize=20, at=[34, 24])
    orange = (230, 159, 0)
    for u in (0, 2, -2):
        _set(tab, u=u)
        assert _is(_pixel(tab, 34 - u, 24), NEAR)  # before it
        assert _is(_pixel(tab, 18 - round(0.5 * u), 24), orange)
    _set(tab, cardDisparity=1.2, u=0)
    assert not _is(_pixel(tab, 34, 18), NEAR)


def test_geometry_hides_what_is_uncertain(tab):
    tab.get_by_role("button", name="Geometry").click()
    count = """() => { const g = document.querySelector('.picture').getContext('webgl2');
      const a = new Uint8Array(960 * 720 * 4);
      g.readPixels(0, 0, 960, 720, g.RGBA, g.UNSIGNED_BYTE, a);
      let n = 0;
      for (let i = 0; i < a.length; i += 4) n += a[i] + a[i + 1] + a[i + 2] > 120;
      return n; }"""
    _set(tab, yaw=0, pitch=0)
    everything = tab.evaluate(count)
    assert everything > 50_000
    _set(tab, bound=-1)
    assert 0.7 * everything < tab.evaluate(count) < 0.95 * everything
    _set(tab, bound=-4)
    assert tab.evaluate(count) < 1000  # the cameras
    _set(tab, bound=1.5, normals=True, surfaces=True, byError=True, colors="disparity")
    assert tab.evaluate(count) > 0.5 * everything
    before = tab.evaluate("mvedge.state.yaw")
    box = tab.locator(".stage").bounding_box()
    tab.mouse.move(box["x"] + 100, box["y"] + 100)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 160, box["y"] + 100)
    tab.mouse.up()
    assert tab.evaluate("mvedge.state.yaw") > before


def test_two_results_are_compared(look):
    tab = look(page(square_field(), result(), result(name="other", shift=0.1)))
    tab.get_by_role("button", name="Compare").click()
    _set(tab, compare="side by side")
    left, right = _pixel(tab, 5, 5), _pixel(tab, 64 + 4 + 5, 5)
    assert np.abs(left.astype(int) - right).max() > 8
    _set(tab, compare="difference", span=0.1)
    assert _pixel(tab, 5, 5)[2] > 80 > _pixel(tab, 5, 5)[0]  # less: blue
    _set(tab, compare="blink")
    assert "shows" in tab.locator(".status").inner_text()
    assert "other" in tab.locator(".notes").inner_text()


def test_a_history_is_gone_through(look):
    steps = np.stack([np.zeros((48, 64)), disparity()])
    tab = look(page(square_field(known=False), result()._replace(states=steps)))
    for step, focus in ((1, 1), (0, 0)):
        _slide(tab, "history", step)
        _click(tab, 34, 24)
        assert tab.evaluate("mvedge.state.focus") == pytest.approx(focus, abs=1e-4)


_LABELS = result()._replace(labels=np.arange(48 * 64).reshape(48, 64))
_LESS = {
    "nothing known": ({"known": False}, ()),
    "one row": ({"grid": (1, 5), "known": False}, (result(),)),
    "missing views": ({"missing": [(0, 0), (4, 4), (4, 3), (3, 4)]}, (result(),)),
    "labels": ({"known": False}, (_LABELS,)),
    "truth alone": ({}, ()),
}


@pytest.mark.parametrize("case", _LESS)
def test_it_works_with_less(look, case):
    known, results = _LESS[case]
    tab = look(page(square_field(**known), *results, quality=100))
    assert _is(_pixel(tab, 34, 24), NEAR)
    _set(tab, u=2)
    assert _is(_pixel(tab, 30, 24), NEAR)
    if case == "missing views":
        _set(tab, v=2)
        assert _is(_pixel(tab, 30, 24), NEAR)
    if case == "labels":
        _set(tab, color="superpixels", opacity=1)
    for button in tab.locator("nav button").all():
        button.click()
        tab.evaluate("mvedge.draw()")
    names = tab.locator("nav button").all_inner_texts()
    assert ("Geometry" in names) == (case != "nothing known")


def test_what_only_other_views_show_is_drawn_in_its_color(look):
    """A row of points before everything else, green as nothing in the scene is."""
    x = np.arange(20.0, 44.0)
    columns = [x, 0 * x + 24, 0 * x + 1.5, 0 * x + 0.01, 0 * x, 0 * x + 1, 0 * x]
    field, seen = square_field(), result()
    tab = look(page(field, seen._replace(hidden=np.stack(columns, 1)), quality=100))
    green = """() => { mvedge.draw(); let n = 0;
      for (let x = 0; x < 960; x += 3) for (let y = 0; y < 720; y += 3) {
        const [r, g, b] = mvedge.pixel(x, y); n += r < 20 && g > 235 && b < 20; }
      return n; }"""
    _set(tab, mode="G", yaw=0, pitch=0)
    assert tab.evaluate(green) > 10
    _set(tab, hidden=False)
    assert tab.evaluate(green) == 0
    _set(tab, hidden=True, bound=-3)
    assert tab.evaluate(green) == 0


def test_a_page_in_a_frame_of_a_notebook(chromium, tmp_path, html):
    """`srcdoc` in a sandbox, as `Inline` shows it."""
    from mvedge_jax.viewer import Inline

    path = Path(tmp_path / "notebook.html")
    path.write_text(Inline(html, 500)._repr_html_(), encoding="utf-8")
    tab = chromium.new_page()
    tab.goto(path.as_uri())
    frame = tab.frames[1]
    frame.evaluate("mvedge.ready")
    assert "disparity" in frame.locator(".status").inner_text()
    tab.close()
