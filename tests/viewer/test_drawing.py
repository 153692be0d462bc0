"""The viewer without a browser: what is drawn, what panels say, what becomes of a run that changes; and the server's port."""

import contextlib
import socket
import time

import numpy as np
import pytest

from piegraph_cli.errors import UsageError
from piegraph_cli.viewer.hand_layer import Hand
from piegraph_cli.viewer.image_layer import Cameras
from piegraph_cli.viewer.layer_panel import LayerPanel
from piegraph_cli.viewer.layers import LAYERS
from piegraph_cli.viewer.object_layers import Cloud, Particles, Truth
from piegraph_cli.viewer.server import address, start_server
from piegraph_cli.viewer.source import OpenRun
from piegraph_cli.viewer.view import add_panels
from piegraph_cli.viewer.viewer import Viewer
from tests.hdf5 import edited
from tests.viewer import made

ALL = ("frames", "masks", "hands", "clouds", "tracks", "scores")


@pytest.fixture
def server():
    made_server = start_server(0)
    yield made_server
    made_server.stop()


@pytest.fixture
def viewer(server, tmp_path):
    """All layers on a whole run, without panels; nothing is drawn but what a test asks for."""
    run = OpenRun.of(made.make_run(tmp_path / "run", *ALL, sequences=("first", "second")))
    found = Viewer(server, [run], LAYERS)
    yield found
    found.close()


def nodes(server) -> set[str]:
    return set(server.scene._handle_from_node_name)


def test_the_port_that_is_told_answers(server):
    with socket.create_connection(("127.0.0.1", int(address(server).rpartition(":")[2])), timeout=5):
        pass


def test_a_port_that_is_taken_is_refused(server):
    with pytest.raises(UsageError, match=f"port {server.get_port()} is taken") as error:
        start_server(server.get_port())
    assert "--port" in error.value.hint


def test_the_last_port_is_refused_too_where_it_is_taken():
    with contextlib.ExitStack() as stack:
        taken = stack.enter_context(socket.socket())
        with contextlib.suppress(OSError):  # somebody else has it: that will do
            taken.bind(("127.0.0.1", 65535))
            taken.listen()
        with pytest.raises(UsageError, match="65535 is taken"):
            start_server(65535)


def test_no_other_machine_reaches_it_and_nothing_is_shared(server):
    assert server.get_host() == "127.0.0.1"
    assert server.request_share_url() is None


def test_frames_move_what_is_drawn(viewer):
    viewer.open(viewer.opened, "first")
    particles = viewer.layer(Particles)
    np.testing.assert_allclose(particles.points.points, made.positions()[0], atol=1e-6)
    viewer.draw_frame(4)
    assert viewer.frame == 4
    np.testing.assert_allclose(particles.points.points, made.positions()[4], atol=1e-6)
    np.testing.assert_array_equal(particles.springs.colors, 190)
    np.testing.assert_allclose(viewer.layer(Cloud).points.colors[0], made.BLUE, atol=4)
    assert viewer.layer(Cameras).frusta[0].image.shape == (made.HEIGHT, made.WIDTH, 3)


def test_the_hand_is_drawn_where_it_was_seen(viewer):
    viewer.open(viewer.opened, "first")
    hand = viewer.layer(Hand)
    assert len(hand.bones.points) == len(hand.tip.points) == 0
    hand.draw(4)
    assert len(hand.joints.points) == 21
    assert len(hand.trail.points) == 3
    np.testing.assert_array_equal(hand.tip.colors, (220, 30, 30))


def test_layers_go_and_come(viewer):
    viewer.open(viewer.opened, "first", 2)
    truth = viewer.layer(Truth)
    assert not any(name.startswith(truth.root) for name in nodes(viewer.server))
    viewer.switch(truth, True)
    assert f"{truth.root}/errors" in nodes(viewer.server)
    np.testing.assert_allclose(truth.points.points, made.positions()[2] + 0.001, atol=1e-6)
    viewer.switch(truth, False)
    assert not any(name.startswith(truth.root) for name in nodes(viewer.server))
    particles = viewer.layer(Particles)
    viewer.leave_alone(particles)
    assert viewer.drawn == {particles}
    viewer.leave_alone(None)
    assert viewer.drawn == viewer.on


def test_another_sequence_begins_at_its_start_and_leaves_nothing_behind(viewer):
    viewer.open(viewer.opened, "first", 5)
    before = nodes(viewer.server)
    viewer.open(viewer.opened, "second")
    assert (viewer.sequence.name, viewer.frame) == ("second", 0)
    assert nodes(viewer.server) == before


def test_an_artifact_that_is_made_anew_is_drawn_anew_at_the_same_frame(viewer):
    viewer.open(viewer.opened, "first", 3)
    made.write(viewer.opened.folder, "tracks", positions=made.positions() + 1)
    viewer._looked = 0.0
    viewer._look_again()
    assert viewer.frame == 3
    np.testing.assert_allclose(viewer.layer(Particles).points.points, made.positions()[3] + 1, atol=1e-6)


def test_a_cloud_that_is_too_large_is_thinned_with_a_word(viewer):
    points = np.random.default_rng(0).uniform(0, 0.1, (50_000, 3)).astype(np.float32)
    offsets = np.array([0, 50_000, *[50_000] * 5])
    made.write(viewer.opened.folder, "clouds", points=points, offsets=offsets)
    viewer.open(viewer.opened, "first")
    cloud = viewer.layer(Cloud)
    assert len(cloud.points.points) == len(cloud.points.colors) <= 20_000
    assert "50,000" in cloud.note


def test_a_damaged_frame_is_told_and_the_others_are_drawn(viewer, monkeypatch):
    told = []
    monkeypatch.setattr(viewer, "tell", lambda *said: told.append(said))
    with edited(viewer.opened.folder / "tracks" / "first.h5") as file:
        file["positions"][2] = np.nan
    viewer.open(viewer.opened, "first")
    told.clear()
    viewer.draw_frame(2)
    assert told
    assert "not finite" in told[0][0]
    told.clear()
    viewer.draw_frame(3)
    assert not told
    np.testing.assert_allclose(viewer.layer(Particles).points.points, made.positions()[3], atol=1e-6)


@contextlib.contextmanager
def running(server, folder):
    """The whole viewer at work on a run."""
    run = OpenRun.of(folder)
    viewer = Viewer(server, [run], LAYERS)
    add_panels(viewer)
    viewer.post(lambda: viewer.open(run, run.names[0] if run.names else ""))
    viewer.start()
    try:
        yield viewer
    finally:
        viewer.close()


def wait_for(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def texts(viewer) -> str:
    """What the notes of the panels say, whichever they are."""
    containers = viewer.server.gui._container_handle_from_uuid.values()
    children = (child for container in containers for child in getattr(container, "_children", {}).values())
    return "\n".join(str(child.content) for child in children if hasattr(child, "content"))


@pytest.mark.parametrize(
    ("artifacts", "expected"),
    [((), "holds cameras.json"), (("frames",), "--until track"), (("frames", "tracks"), "--until dataset")],
)
def test_a_run_that_is_not_done_says_what_comes_next(server, tmp_path, artifacts, expected):
    with running(server, made.make_run(tmp_path / "run", *artifacts)) as viewer:
        wait_for(lambda: expected in texts(viewer))
        assert len(viewer.sequence) == (made.FRAMES if artifacts else 0)


def test_playing_goes_to_the_end_and_stops(server, tmp_path):
    with running(server, made.make_run(tmp_path / "run", "tracks", "frames")) as viewer:
        wait_for(lambda: len(viewer.sequence) > 0)
        play = next(
            child
            for container in server.gui._container_handle_from_uuid.values()
            for child in container._children.values()
            if getattr(child, "label", "") == "play"
        )
        viewer.post(lambda: play._impl.update_cb[0](None))
        wait_for(lambda: viewer.frame == made.FRAMES - 1)
        wait_for(lambda: play.label == "play")


def test_the_boxes_of_layers_without_data_are_off(server, tmp_path):
    run = OpenRun.of(made.make_run(tmp_path / "run", "frames"))
    viewer = Viewer(server, [run], LAYERS)
    panel = LayerPanel(viewer)
    viewer.open(run, "first")
    disabled = {layer.name for layer, box in panel.boxes.items() if box.disabled}
    assert disabled == {"hand", "cloud", "particles", "true particles"}
    assert "--until fuse" in panel.note.content
    viewer.close()
