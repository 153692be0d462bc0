"""A few fixed places at which commands write, on a disk that is full there; `python -m tests.attack.full_disk` has all."""

import errno
import shutil

import pytest

from tests.attack.full_disk import Attempts, places_in
from tests.attack.shim import build
from tests.attack.writers import writers

PLACES = {
    "train --force": ["write run/checkpoints/train.piegraph.seed0.h5"],
    "plan --force": ["open run/plan.h5", "sync run/plan.h5"],
    "report": ["write run/report/index.html"],
}


@pytest.mark.parametrize("name", PLACES)
def test_what_is_full_is_named_and_the_same_command_goes_on(tmp_path, tiny_run, tiny_recipe, name):
    library = build(tmp_path)
    if library is None:
        pytest.skip("no C compiler to build what lets calls fail")

    def made(_):
        folder = tmp_path / "made"
        if not folder.exists():
            shutil.copytree(tiny_run, folder / "run")
            shutil.copy(tiny_recipe, folder / "recipe.toml")
        return folder

    (writer,) = (writer for writer in writers(made) if writer.name == name)
    attempts = Attempts(writer, tmp_path / "tried", library)
    places = {f"{place.call} {place.path}": place for place in places_in(attempts.log)}
    for k, of in enumerate(PLACES[name]):
        assert of in places, list(places)
        outcome, wrong = attempts.attack(places[of], (errno.ENOSPC, errno.EDQUOT)[k % 2], once=k == 1)
        assert outcome == "refused"
        assert not wrong
