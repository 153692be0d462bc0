"""Rigid fits, and guidance against them: on a stiff object both must say the same."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from piegraph_cli.physics.params import GuidanceParams
from piegraph_cli.physics.rigid import kabsch, rigid_projection
from piegraph_cli.physics.simulation import guide
from piegraph_cli.physics.springs import build_springs, stability_bound
from tests.physics.objects import particles


def test_kabsch_recovers_a_batch_of_motions():
    rng = np.random.default_rng(0)
    source = torch.as_tensor(rng.normal(size=(8, 20, 3)))
    rotation = torch.as_tensor(Rotation.random(8, rng).as_matrix())
    shift = torch.as_tensor(rng.normal(size=(8, 3)))
    found, found_shift = kabsch(source, source @ rotation.transpose(1, 2) + shift[:, None])
    torch.testing.assert_close(found, rotation)
    torch.testing.assert_close(found_shift, shift)


def test_kabsch_never_mirrors():
    source = torch.as_tensor(np.random.default_rng(0).normal(size=(5, 20, 3)))
    rotation, _ = kabsch(source, source * torch.tensor([1.0, 1.0, -1.0]).double())
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(5).double())


def test_kabsch_without_weight_ignores_a_stray_point():
    source = torch.as_tensor(np.random.default_rng(0).normal(size=(1, 20, 3)))
    target = source + 0.3
    target[0, 4] += 50
    weights = torch.ones(20).double()
    weights[4] = 0
    rotation, shift = kabsch(source, target, weights)
    torch.testing.assert_close(rotation[0], torch.eye(3).double())
    torch.testing.assert_close(shift[0], torch.full((3,), 0.3).double())


def test_guidance_of_a_stiff_object_is_its_rigid_projection():
    rest = torch.as_tensor(particles()).expand(3, 50, 3)
    graph = build_springs(rest[0].numpy(), 0.12)  # far-reaching springs and a weak pull make it stiff
    rng = np.random.default_rng(0)
    turn = torch.as_tensor(Rotation.from_euler("z", rng.uniform(-1, 1, (3, 1))).as_matrix())
    setpoint = rest @ turn.transpose(1, 2) + torch.as_tensor(rng.uniform(0.05, 0.1, (3, 1, 3)))
    noisy = setpoint + torch.as_tensor(rng.normal(0, 0.01, setpoint.shape))
    stiffness = 0.9 * stability_bound(graph, 0.8, 0.001)
    guided = guide(rest, noisy, graph, GuidanceParams(stiffness=stiffness, gain=0.001, iterations=2000, tolerance=1e-7))
    projected = rigid_projection(rest, noisy)
    apart = (guided - projected).norm(dim=2).mean()
    assert float(apart) < 0.05 * float((noisy - projected).norm(dim=2).mean())
