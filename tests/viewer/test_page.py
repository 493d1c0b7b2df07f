"""What of the page needs no browser: what it holds, its server, its files."""

import base64
import http.client
import importlib.resources
import json
import shutil
import socket
import subprocess
import threading
import zlib

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from viewer.scenes import disparity, result, square_field

from mvedge_jax import viewer
from mvedge_jax.datasets import write_pfm
from mvedge_jax.posed import Photographs
from mvedge_jax.viewer import page, read_result, serve, show


def _data(html: str) -> dict:
    return json.loads(html.split('id="data">')[1].split("</script>")[0])


def _unpacked(column: dict) -> np.ndarray:
    raw = np.frombuffer(zlib.decompress(base64.b64decode(column["data"])), np.uint8)
    low, high = raw.reshape(2, *column["shape"]).astype(np.uint16)
    codes = np.cumsum(low + 256 * high, axis=-1, dtype=np.uint16)
    values = column["low"] + codes * (column["high"] - column["low"]) / 65534
    values = np.exp(values) if column["log"] else values
    return np.where(codes == 65535, np.nan, values)


def test_maps_and_points_keep_sixteen_bits():
    rng = np.random.default_rng(0)
    given = result()._replace(disparity=rng.normal(size=(48, 64)))
    given.disparity[3, 4:6] = np.nan, np.inf
    assert given.error is not None
    found = _data(page(square_field(), given))["results"][0]
    known = np.isfinite(given.disparity)
    step = np.ptp(given.disparity[known]) / 65534
    read = _unpacked(found["disparity"])
    assert np.array_equal(np.isfinite(read), known)
    assert np.abs(read - given.disparity)[known].max() <= 0.5001 * step
    error = _unpacked(found["error"])
    assert np.isnan(error[0, 0])
    np.testing.assert_allclose(error[1:], given.error[1:], rtol=1e-4)
    np.testing.assert_allclose(_unpacked(found["points"]["x"]), [24, 24, 43], atol=1e-3)
    np.testing.assert_allclose(_unpacked(found["points"]["error"]), [0.02, 0.02, 0.05], rtol=1e-4)


def test_views_are_pictures_and_the_best_quality_loses_nothing():
    field = square_field(missing=[(0, 0)])
    views = _data(page(field, quality=100))["views"]
    assert views[0] is None
    raw = np.frombuffer(base64.b64decode(views[1]), np.uint8)
    seen = cv2.imdecode(raw, cv2.IMREAD_COLOR)
    assert seen is not None
    np.testing.assert_array_equal(seen[..., ::-1], np.round(255 * np.asarray(field.views[0, 1])))
    noise = jax.random.uniform(jax.random.key(0), field.views.shape)
    noisy = type(field)(noise)
    small, large = (_data(page(noisy, quality=q))["views"] for q in (50, 95))
    assert sum(map(len, small)) < 0.6 * sum(map(len, large))


def test_nothing_of_a_name_becomes_markup():
    name = "</script><script>alert(1)</script>"
    html = page(square_field(), result(name=name))
    assert name not in html
    assert _data(html)["results"][0]["name"] == name


def test_the_page_is_small_asks_nobody_and_its_scripts_parse():
    folder = importlib.resources.files("mvedge_jax.viewer") / "page"
    parts = {item.name: item.read_text("utf-8") for item in folder.iterdir() if item.is_file()}
    assert sum(map(len, parts.values())) < 100_000
    assert "default-src 'none'" in parts["page.html"]
    for name, text in parts.items():
        assert not [word for word in ("://", "import(", "fetch(") if word in text], name
        if name.endswith(".js") and shutil.which("node"):
            subprocess.run(["node", "--check", str(folder / name)], check=True)


def test_nothing_at_all_is_known():
    flat = np.full((48, 64), np.nan)
    data = _data(page(square_field(known=False), result()._replace(disparity=flat, error=flat)))
    assert (data["truth"], data["camera"], data["results"][0]["scores"]) == (None, None, [])
    assert data["range"][0] < data["range"][1]


@pytest.mark.parametrize(
    ("results", "quality", "message"),
    [
        ([], 0, "`quality` must be between 1 and 100, got 0"),
        ([result(), result()], 90, "`results` must have different names"),
        ([result(name="truth")], 90, "none of them truth"),
        ([viewer.Result("small", np.zeros((4, 5)))], 90, "64x48 px, got 5x4"),
    ],
)
def test_what_does_not_fit_is_refused(results, quality, message):
    with pytest.raises(ValueError, match=message):
        page(square_field(), *results, quality=quality)


def test_a_result_is_read_from_its_folder(tmp_path):
    given = result()
    assert given.error is not None
    assert given.xy is not None
    write_pfm(tmp_path / "disparity.pfm", disparity())
    alone = read_result(tmp_path / "disparity.pfm")
    assert (alone.name, alone.error) == ("disparity", None)
    write_pfm(tmp_path / "standard_error.pfm", given.error)
    write_pfm(tmp_path / "before.pfm", 0 * disparity())
    np.savez(tmp_path / "points.npz", xy=given.xy, disparity=[1.0, 1.0, 0.9], error=[0.1] * 3)
    found = read_result(tmp_path, name="all")
    np.testing.assert_array_equal(found.disparity, disparity())
    assert found.states is not None
    assert found.states.shape == (2, 48, 64)
    assert found.points is not None
    assert found.points.shape == (3, 2)
    assert found.normals is None
    (tmp_path / "points.npz").write_bytes(b"PK damaged")
    with pytest.raises(ValueError, match="could not be read as points"):
        read_result(tmp_path)
    write_pfm(tmp_path / "before.pfm", np.zeros((3, 3)))
    with pytest.raises(ValueError, match="must have the size of disparity"):
        read_result(tmp_path)


def test_a_notebook_gets_a_frame(tmp_path):
    shown = show(square_field(), result(), result(name="b"), height=300)
    frame = shown._repr_html_()
    assert frame.startswith('<iframe sandbox="allow-scripts"')
    assert "height: 300px" in frame
    assert "<script" not in frame
    shown.save(tmp_path / "page.html")
    assert len(_data((tmp_path / "page.html").read_text("utf-8"))["results"]) == 2


@pytest.fixture
def running():
    with serve("<p>page", port=0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def _get(server, path="/", method="GET", host=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=5)
    connection.request(method, path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


def test_the_server_is_of_this_machine_and_has_one_page(running, capfd):
    assert running.server_address[0] == "127.0.0.1"
    assert _get(running) == (200, b"<p>page")
    assert _get(running, method="HEAD") == (200, b"")
    assert _get(running, "/../etc/passwd")[0] == 404
    assert _get(running, host="elsewhere.example")[0] == 403
    with socket.create_connection(running.server_address) as client:  # a browser that is closed
        client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    assert _get(running)[0] == 200
    assert "Traceback" not in capfd.readouterr().err


def test_a_port_in_use_is_passed_over(running):
    taken = running.server_address[1]
    with serve("other", port=taken) as second:
        assert taken < second.server_address[1] <= taken + 20


def test_hidden_surfaces_are_the_most_certain_points_of_other_views():
    """Of the plane behind the square, every view shows what its own shift uncovers."""
    field = square_field(missing=[(0, 0)])
    shape = field.views.shape[:4]
    far = np.zeros(shape)
    error = np.random.default_rng(0).uniform(0.1, 1, shape)
    source = np.zeros(shape, np.int8)
    source[2, 4, 20, 50:54] = 1
    source[0, 4, 20, 50:54] = 1
    source[0, 0, 20, 24:28] = 1  # a view that is not there
    source[4, 4, 5, 5:9] = 2  # seen by none
    far[2, 0, 8, 8], source[2, 0, 8, 8] = np.nan, 1
    found = viewer.hidden_surfaces(field, far, error, source)
    assert (np.diff(found[:, 3]) > 0).all()
    found = found[np.argsort(found[:, 0])]
    assert found[:, :2].tolist() == [[50 + k, 20] for k in range(4)]
    least = np.minimum(error[2, 4, 20, 50:54], error[0, 4, 20, 50:54])
    assert found[:, 3] == pytest.approx(least)
    assert found[:, 4:] == pytest.approx(np.tile(np.asarray(field.views)[2, 4, 20, 50], (4, 1)))
    # A disparity carries a point to where the center view would show it.
    near = viewer.hidden_surfaces(field, far + 0.5, error, source)
    row = near[near[:, 1] == 20]  # of view (2, 4), two steps to the right of the center
    assert sorted(row[:, 0]) == [51, 52, 53, 54]
    packed = _data(page(field, result()._replace(hidden=found)))["results"][0]["hidden"]
    assert _unpacked(packed["error"]) == pytest.approx(found[:, 3], rel=1e-3)


def test_depth_of_a_photograph_becomes_disparity():
    image = np.full((2, 8, 10, 3), 0.5, np.float32)
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 0.1
    pair = Photographs(image, poses, np.array([[20.0, 0, 3.5], [0, 20.0, 2.5], [0, 0, 1]]))
    depth, error = np.full((8, 10), 4.0), np.full((8, 10), 0.2)
    depth[0, :3] = 0, np.nan, np.inf
    field, found = viewer.result_of_photograph(pair, 1, depth, error=error, baseline=0.5)
    assert field.views.shape == (1, 1, 8, 10, 3)
    assert np.isnan(found.disparity[0, :3]).all()
    np.testing.assert_allclose(found.disparity[1:], 2.5)
    assert found.error is not None
    np.testing.assert_allclose(found.error[1:], 2.5 * 0.2 / 4)
    assert field.camera is not None
    np.testing.assert_allclose(field.camera.depth(jnp.asarray(found.disparity[1:])), 4)
    assert "a view of 10x8 px" in page(field, found)
    with pytest.raises(ValueError, match="`depth` must have the size of the photograph"):
        viewer.result_of_photograph(pair, 1, depth[1:])
    with pytest.raises(ValueError, match="`baseline` must be a positive number, got 0"):
        viewer.result_of_photograph(pair, 1, depth, baseline=0.0)
