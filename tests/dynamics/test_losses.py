"""What training minimises: what was not seen has no part in it."""

import torch

from piegraph_cli.dynamics.losses import dynamics_loss


def test_particles_that_are_not_seen_carry_no_weight():
    rng = torch.Generator().manual_seed(0)
    target, off = (torch.rand(3, 8, 3, generator=rng) for _ in range(2))
    predicted = target + 0.1 * off
    neighbors = torch.tensor([[(i + 1) % 8, (i + 2) % 8] for i in range(8)]).expand(3, 8, 2)
    seen = torch.ones(3, 8, dtype=torch.bool)
    everything = dynamics_loss(predicted, target, neighbors, 0.1)
    torch.testing.assert_close(dynamics_loss(predicted, target, neighbors, 0.1, seen), everything)
    seen[:, 5] = False
    without = dynamics_loss(predicted, target, neighbors, 0.1, seen)
    predicted[:, 5] += 10
    torch.testing.assert_close(dynamics_loss(predicted, target, neighbors, 0.1, seen), without)
    assert dynamics_loss(predicted, target, neighbors, 0.1) > 100 * without
    assert dynamics_loss(predicted, target, neighbors, 0.1, torch.zeros_like(seen)) == 0
