"""Particles over time that others measured: the three kinds of files, and what is wrong with them."""

import numpy as np
import pytest

from piegraph_cli.errors import DataError
from piegraph_cli.recording.motion import list_files, read_motion
from piegraph_cli.stages.import_tracks import READERS

FRAMES, COUNT = 12, 10


def motion(**changes) -> dict[str, np.ndarray]:
    """Ten markers in a row that a hand pushes along y from its fifth frame on, at 5 Hz."""
    pushed = np.maximum(np.arange(FRAMES) - 4, 0) * 0.01
    particles = np.zeros((FRAMES, COUNT, 3))
    particles[..., 0] = np.linspace(-0.1, 0.1, COUNT)
    particles[..., 1] = pushed[:, None]
    particles[..., 2] = 0.01
    hand = np.stack([np.full(FRAMES, 0.011), np.arange(FRAMES) * 0.01 - 0.06, np.full(FRAMES, 0.02)], 1)
    return {"particles": particles, "end_effector": hand, "times": 3.0 + np.arange(FRAMES) / 5} | changes


def write(folder, suffix, data, columns=None):
    path = folder / f"take one{suffix}"
    if suffix == ".npz":
        np.savez(path, **data)
    elif suffix == ".h5":
        import h5py

        with h5py.File(path, "w") as file:
            for name, value in data.items():
                file[name] = np.asarray(value)
    else:
        names, rows = columns or [], data
        if not names:
            names, rows = table(data)
        path.write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def table(data) -> tuple[list[str], list[list]]:
    """The columns and rows of a CSV file."""
    names = ["time", "ee_x", "ee_y", "ee_z", *(name for name in ("contact", "mode") if name in data)]
    names += [f"p{k}_{axis}" for k in range(data["particles"].shape[1]) for axis in "xyz"]
    rows = []
    for f in range(len(data["times"])):
        flags = [data[name][f] for name in ("contact", "mode") if name in data]
        rows.append([data["times"][f], *data["end_effector"][f], *flags, *data["particles"][f].ravel()])
    return names, rows


def read(path, **settings):
    return read_motion(path, **{"radius": 0.03, "mode": "push", "more": READERS} | settings)


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".csv"])
def test_every_kind_of_file_gives_the_same(tmp_path, suffix):
    contact = np.arange(FRAMES) % 2
    data = motion(contact=contact, mode=np.full(FRAMES, 1))
    found = read(write(tmp_path, suffix, data))
    np.testing.assert_allclose(found.positions, data["particles"], atol=1e-6)
    np.testing.assert_allclose(found.end_effector, data["end_effector"], atol=1e-6)
    np.testing.assert_array_equal(found.time, data["times"])
    assert found.contact.tolist() == (contact == 1).tolist()
    assert found.mode.tolist() == [1] * FRAMES
    assert found.visibility.shape == (FRAMES, COUNT)
    assert found.visibility.all()
    assert (found.warnings, found.contact_given) == ([], True)


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".csv"])
def test_contact_and_mode_that_are_not_given_are_found(tmp_path, suffix):
    found = read(write(tmp_path, suffix, motion()), mode="pick")
    distance = np.linalg.norm(motion()["particles"] - motion()["end_effector"][:, None], axis=2).min(1)
    assert found.contact.tolist() == (distance <= 0.03).tolist()
    assert 0 < found.contact.sum() < FRAMES
    assert found.mode.tolist() == [1] * FRAMES
    assert not found.contact_given
    never = read(write(tmp_path, suffix, motion()), radius=0.001)
    assert "raise radius" in never.warnings[0]


@pytest.mark.parametrize("words", [["push", "pick"] * 6, ["0", "1"] * 6])
def test_modes_may_be_words(tmp_path, words):
    for suffix in (".npz", ".csv"):
        assert read(write(tmp_path, suffix, motion(mode=np.array(words)))).mode.tolist() == [0, 1] * 6
    with pytest.raises(DataError, match="mode is 'shove'"):
        read(write(tmp_path, ".npz", motion(mode=np.array(["push"] * 11 + ["shove"]))))


def test_other_names_and_a_trackers_visibility_are_known(tmp_path):
    data = motion()
    data = {"positions": data["particles"], "time": data["times"], "end_effector": data["end_effector"]}
    seen = np.full((FRAMES, COUNT), 0.25)
    found = read(write(tmp_path, ".npz", data | {"visibility": seen, "note": np.array(["what else there is"])}))
    assert (found.visibility == 0.25).all()
    with pytest.raises(DataError, match="both particles and positions"):
        read(write(tmp_path, ".npz", data | {"particles": data["positions"]}))


def changed(name, frame, value, base=None):
    array = np.array((base or motion())[name], float)
    array[frame] = value
    return {name: array}


def millimetres(name):
    return {name: motion()[name] * 1000}


def turned_down():
    return {name: motion()[name] * [1, -1, -1] for name in ("particles", "end_effector")}


WRONG = {
    "nan": (changed("particles", (3, 7, 1), np.nan), "frame 3", "particle 7 is not finite"),
    "infinite hand": (changed("end_effector", (4, 0), np.inf), "frame 4", "end_effector is not finite"),
    "nan time": (changed("times", 2, np.nan), "frame 2", "times is not finite"),
    "particles in mm": (millimetres("particles"), "frame 0", "the object is 200 m large"),
    "both in mm": (millimetres("particles") | millimetres("end_effector"), "frame 0", "the object is 200 m large"),
    "hand in mm": (millimetres("end_effector"), "frame 0", "the end-effector is"),
    "a point": ({"particles": motion()["particles"] * 0.001}, "frame 0", "the object is 0.0002 m large"),
    "back in time": (changed("times", 5, 3.7), "frame 5", "time goes from 3.8 to 3.7 s"),
    "the same time twice": (changed("times", 5, 3.8), "frame 5", "time goes from 3.8 to 3.8 s"),
    "milliseconds": ({"times": motion()["times"] * 1000}, "frame 1", "frames are 200 s apart"),
    "fast in milliseconds": ({"times": np.arange(FRAMES) * 40.0}, "frame 1", "frames are 40 s apart"),
    "nanoseconds": ({"times": motion()["times"] * 1e9}, "frame 1", "apart"),
    "a jump": (changed("particles", (8, 2), [0.0, 0.9, 0.01]), "frame 8", "particle 2 jumps by 0.8"),
    "z down": (turned_down(), "frame 0", "mm below the table"),
    "contact": ({"contact": np.arange(FRAMES)}, "frame 2", "contact is 2"),
    "mode": ({"mode": np.arange(FRAMES)}, "frame 2", "mode is '?2"),
}


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".csv"])
@pytest.mark.parametrize("kind", WRONG)
def test_what_is_wrong_is_said_with_its_frame_and_what_to_do(tmp_path, suffix, kind):
    changes, frame, message = WRONG[kind]
    path = write(tmp_path, suffix, motion(**changes))
    with pytest.raises(DataError, match=message) as error:
        read(path)
    line = f" (line {int(frame.split()[1]) + 2})" if suffix == ".csv" else ""
    assert error.value.where == f"{path}, {frame}{line}"
    assert error.value.hint


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"end_effector": np.zeros((FRAMES, 2))}, r"end_effector is \[12, 2\], expected \[12, 3\]"),
        ({"times": np.arange(FRAMES - 1)}, r"times is \[11\], expected \[12\]"),
        ({"contact": np.zeros((FRAMES, 1))}, r"contact is \[12, 1\]"),
        ({"particles": np.zeros((FRAMES, 3))}, r"particles is \[12, 3\]"),
        ({"particles": np.zeros((FRAMES, 3, 3))}, "has 3 particles"),
        ({"particles": np.zeros((0, 10, 3)), "end_effector": np.zeros((0, 3)), "times": np.zeros(0)}, "has 0 frames"),
        ({"particles": np.zeros((FRAMES, 10, 3), complex)}, "complex128"),
    ],
)
def test_arrays_that_disagree(tmp_path, suffix, changes, message):
    with pytest.raises(DataError, match=message):
        read(write(tmp_path, suffix, motion(**changes)))


@pytest.mark.parametrize("name", ["particles", "end_effector", "times"])
@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_an_array_that_is_missing_is_named(tmp_path, suffix, name):
    data = motion()
    del data[name]
    with pytest.raises(DataError, match=f"has no array {name}"):
        read(write(tmp_path, suffix, data))


def test_particles_that_change_in_number_are_refused(tmp_path):
    names, rows = table(motion())
    with pytest.raises(DataError, match="has 31 columns, the first line has 34") as error:
        read(write(tmp_path, ".csv", [*rows[:4], rows[4][:-3]], names))
    assert error.value.where.endswith("line 6")
    ragged = np.empty(2, object)
    ragged[:] = [np.zeros((10, 3)), np.zeros((9, 3))]
    with pytest.raises(DataError, match="Python objects"):
        read(write(tmp_path, ".npz", motion(particles=ragged)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ee_z", "ee_q", "has no column ee_z"),
        ("p3_y", "p3_q", "has no column p3_y"),
        ("p9_z", "p8_z", "has no column p9_z"),
        ("time", "t", "has no column time"),
        ("time,", "time,force,", "column 'force' is not known"),
        ("time,", "time,ee_x,", "column 'ee_x' is there twice"),
        (",", ";", "has no column time"),
    ],
)
def test_columns_that_are_wrong(tmp_path, old, new, message):
    path = write(tmp_path, ".csv", motion())
    head, rest = path.read_text().split("\n", 1)
    path.write_text(head.replace(old, new) + "\n" + rest)
    with pytest.raises(DataError, match=message) as error:
        read(path)
    assert error.value.where == f"{path}, line 1"


@pytest.mark.parametrize(("cell", "message"), [("", "p0_x: is empty"), ("0;1", "p0_x: '0;1' is no number")])
def test_a_cell_that_is_no_number_is_named(tmp_path, cell, message):
    names, rows = table(motion())
    rows[5][4] = cell
    with pytest.raises(DataError, match=message) as error:
        read(write(tmp_path, ".csv", rows, names))
    assert error.value.where.endswith("line 7")


@pytest.mark.parametrize("text", ["", "\n\n", "time,ee_x\n", "\xff\xfe\x00", '"unfinished'])
def test_files_that_are_no_tables(tmp_path, text):
    path = tmp_path / "take.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError):
        read(path)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_files_cut_off_or_of_no_bytes(tmp_path, suffix):
    path = write(tmp_path, suffix, motion())
    whole = path.read_bytes()
    for part in (whole[: len(whole) // 2], b"", b"no such thing"):
        path.write_bytes(part)
        with pytest.raises(DataError):
            read(path)


def test_nothing_in_an_hdf5_file_leads_elsewhere(tmp_path):
    import h5py

    other = write(tmp_path, ".h5", motion()).rename(tmp_path / "other.h5")
    layout = h5py.VirtualLayout((FRAMES, COUNT, 3), float)
    layout[...] = h5py.VirtualSource(str(other), "particles", (FRAMES, COUNT, 3))
    raw = tmp_path / "raw"
    raw.write_bytes(motion()["particles"].tobytes())

    def external(file):
        file.create_dataset("particles", (FRAMES, COUNT, 3), float, external=[(str(raw), 0, h5py.h5f.UNLIMITED)])

    puts = {
        "link": lambda f: f.__setitem__("particles", h5py.ExternalLink(str(other), "particles")),
        "is a link,": lambda f: f.__setitem__("particles", h5py.SoftLink("/end_effector")),
        "a group": lambda f: f.create_group("particles"),
        "other files": lambda f: f.create_virtual_dataset("particles", layout),
        "from other files": external,
        "type": lambda f: f.create_dataset("particles", data=["a", "b"], dtype=h5py.string_dtype()),
    }
    for message, put in puts.items():
        path = write(tmp_path, ".h5", {k: v for k, v in motion().items() if k != "particles"})
        with h5py.File(path, "a") as file:
            put(file)
        with pytest.raises(DataError, match=message) as error:
            read(path)
        assert "dataset particles" in error.value.where


def test_what_may_be_wrong_is_a_warning(tmp_path):
    up = [0, 0, 0.7]
    high = motion(particles=motion()["particles"] + up, end_effector=motion()["end_effector"] + up)
    assert "0.71 m above z = 0" in read(write(tmp_path, ".npz", high)).warnings[0]
    y_up = motion(particles=motion()["particles"][..., [0, 2, 1]], end_effector=motion()["end_effector"][:, [0, 2, 1]])
    assert any("is y up?" in warning for warning in read(write(tmp_path, ".npz", y_up)).warnings)


def test_a_folder_gives_its_files_by_number(tmp_path):
    for name in ("take10.csv", "take2.npz", "take1.h5", ".take3.csv", "notes.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in list_files(tmp_path, READERS)] == ["take1.h5", "take2.npz", "take10.csv"]
    with pytest.raises(DataError, match=r"cannot import \.txt"):
        list_files(tmp_path / "notes.txt", READERS)
    with pytest.raises(DataError, match="no such file or folder"):
        list_files(tmp_path / "none.csv", READERS)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="no file to import"):
        list_files(tmp_path / "empty", READERS)


def wandering(**changes):
    """Ten markers in a row that a hand pushes, in contact where they move."""
    data = motion()
    return data | {"contact": (np.arange(FRAMES) >= 4).astype(int)} | changes


def test_markers_that_exchange_places_are_named_with_the_frame(tmp_path):
    particles = motion()["particles"].copy()
    particles[7:, [2, 5]] = particles[7:, [5, 2]]
    with pytest.raises(DataError, match=r"frame 7: 2 particles take each other's places: 2, 5"):
        read(write(tmp_path, ".npz", motion(particles=particles)))
    rng = np.random.default_rng(0)
    shuffled = np.stack([one[rng.permutation(COUNT)] for one in motion()["particles"]])
    with pytest.raises(DataError, match=r"frame \d: .* take each other's places"):
        read(write(tmp_path, ".npz", motion(particles=shuffled)))


def test_bending_and_moving_by_whole_spacings_is_no_exchange(tmp_path):
    particles = motion()["particles"].copy()
    particles[..., 0] += np.arange(FRAMES)[:, None] * 0.2 / (COUNT - 1)  # each goes where the next one was
    assert read(write(tmp_path, ".npz", wandering(particles=particles))).positions.shape == (FRAMES, COUNT, 3)


@pytest.mark.parametrize("name", ["particles", "end_effector"])
def test_lost_markers_that_are_written_as_zeros_are_named(tmp_path, name):
    data = motion()
    data[name] = data[name].copy()
    (data[name][:, 3] if name == "particles" else data[name])[6:8] = 0
    with pytest.raises(DataError, match=r"frame 6: .* is at 0, 0, 0: was it lost"):
        read(write(tmp_path, ".npz", data))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"contact": np.arange(FRAMES) < 4}, "the object moves by 0.07 m while nothing touches it, by 0 m in contact"),
        ({"particles": np.repeat(motion()["particles"][:1], FRAMES, 0)}, "no particle moves by more than 1 mm"),
        ({"times": np.arange(FRAMES)}, "times are whole numbers, 1 apart: are these frame numbers"),
        ({"times": np.arange(FRAMES) / 5 / 60}, "are times seconds"),
        ({"times": np.arange(FRAMES) / 5 + 20 * (np.arange(FRAMES) > 6)}, "times leap 20.2 s ahead at frame 7"),
    ],
)
def test_what_is_well_formed_and_hardly_right_is_said(tmp_path, changes, said):
    assert read(write(tmp_path, ".npz", wandering())).warnings == []
    assert said in " ".join(read(write(tmp_path, ".npz", wandering(**changes))).warnings)


def test_an_end_effector_that_nobody_saw_does_not_touch(tmp_path):
    hand = motion()["end_effector"].copy()
    hand[:3] = np.nan
    found = read(write(tmp_path, ".npz", motion(end_effector=hand)))
    assert not found.contact[:3].any()
    assert "not known in 3 of 12 frames" in found.warnings[0]
    with pytest.raises(DataError, match="frame 0: end_effector is not finite where it touches"):
        read(write(tmp_path, ".npz", motion(end_effector=hand, contact=np.ones(FRAMES))))


@pytest.mark.parametrize(("mark", "point"), [(";", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_tables_of_spreadsheets_of_other_countries_are_read(tmp_path, mark, point):
    names, rows = table(motion())
    path = tmp_path / "take.csv"
    lines = [mark.join(names), *(mark.join(str(value).replace(".", point) for value in row) for row in rows)]
    path.write_bytes(("\r\r\n".join(lines) + "\r\r\n").encode("utf-8-sig"))
    np.testing.assert_allclose(read(path).positions, motion()["particles"], atol=1e-6)


def grid(turned=0.0):
    """A block of 6 x 8 markers that a hand pushes along y from the eighth of 30 frames on, at 30 Hz."""
    x, y = np.meshgrid(np.arange(8) * 0.02, np.arange(6) * 0.02)
    rest = np.stack([x.ravel(), y.ravel(), np.full(48, 0.01)], 1)
    gone = np.clip(np.arange(30) - 8, 0, 14)[:, None] ** 1.5 * 0.002
    particles, hand = np.repeat(rest[None], 30, 0), np.repeat([[0.07, -0.02, 0.02]], 30, 0)
    particles[..., 1] += gone
    hand[:, 1] += gone[:, 0] - np.clip(8 - np.arange(30), 0, 8) * 0.01
    return {"particles": particles, "end_effector": hand, "times": np.arange(30) / 30}


@pytest.mark.parametrize("order", [np.roll(np.arange(48), 1), np.random.default_rng(0).permutation(48)])
def test_an_order_that_changes_while_all_moves_is_named_with_the_frame(tmp_path, order):
    data = grid()
    assert read(write(tmp_path, ".npz", data)).warnings == []
    data["particles"][15:] = data["particles"][15:, order] + [0, 0.05, 0]
    with pytest.raises(DataError, match=r"frame 15: .* particles (leave those beside them|take each other)"):
        read(write(tmp_path, ".npz", data))


@pytest.mark.parametrize("frames", [4, -4])
def test_a_hand_on_another_clock_is_said_with_the_seconds(tmp_path, frames):
    data = grid()
    data["end_effector"] = data["end_effector"][np.clip(np.arange(30) - frames, 0, 29)]
    data["contact"] = (np.arange(30) > 3).astype(int)
    (said,) = read(write(tmp_path, ".npz", data)).warnings
    assert f"the end-effector is 0.14 s {'behind' if frames > 0 else 'ahead of'} the particles" in said


def test_contact_that_is_said_from_afar_is_doubted(tmp_path):
    data = grid() | {"contact": np.ones(30, int)}
    data["end_effector"][:8, 1] -= 0.1
    (said,) = read(write(tmp_path, ".npz", data)).warnings
    assert "m from the object: is contact right?" in said


def test_seconds_between_frames_are_doubted(tmp_path):
    data = grid()
    data["times"] = np.arange(30) * 33.333 / 10
    assert "frames are 3.33 s apart: are these milliseconds?" in " ".join(read(write(tmp_path, ".npz", data)).warnings)
