"""One frame of `pgnd` and `gbnd` against what they are by definition: every node, every edge, one at a time."""

import math

import pytest
import torch
from torch import Tensor

from piegraph_cli.dynamics import gbnd, pgnd
from piegraph_cli.dynamics.egnn import DECIMETRE
from piegraph_cli.dynamics.params import GBNDParams, PGNDParams
from piegraph_cli.params import PICK, PUSH


def scenes(frames: int) -> tuple[Tensor, Tensor, Tensor]:
    """Past frames [3, frames, 20, 3] (m) of three objects of other sizes, and a hand near each now and next [3, 2]."""
    generator = torch.Generator().manual_seed(0)
    size = torch.tensor([0.05, 0.1, 0.2], dtype=torch.float64)[:, None, None, None]
    place = torch.rand(3, 1, 20, 3, generator=generator, dtype=torch.float64) * torch.tensor([1, 1, 0.2]) * size
    past = place + 0.004 * torch.rand(3, frames, 20, 3, generator=generator, dtype=torch.float64)
    hand = past[:, -1, 0, :2] - 0.02
    return past, hand, hand + 0.007


def gradients(loss: Tensor, network: torch.nn.Module, past: Tensor) -> list[Tensor]:
    return list(torch.autograd.grad(loss, [past, *network.parameters()], allow_unused=True, materialize_grads=True))


def close(network: torch.nn.Module, found: Tensor, expected: Tensor, past: Tensor) -> None:
    """The same places, and the same gradient of them in every weight and in the past: the same seed learns the same."""
    torch.testing.assert_close(found, expected, atol=1e-13, rtol=0)
    pairs = zip(*(gradients(x.square().sum(), network, past) for x in (found, expected)), strict=True)
    for one, other in pairs:
        torch.testing.assert_close(one, other, atol=1e-11, rtol=1e-9)


def velocity_by_definition(
    network: pgnd.PGND, nodes: Tensor, positions: Tensor, counts: Tensor, features: Tensor, centre: Tensor
) -> Tensor:
    """What the decoder makes of each node's place, its waves, and the mean feature of the particles around."""
    at = nodes.to(positions) * network.params.cell
    near = torch.cdist(at, positions.detach()).lt(network.params.reach) & counts[:, None]
    feature = near.to(at) @ features / near.sum(-1, keepdim=True).clamp_min(1)
    place = (at - centre[:, None]) * math.pi
    waves = torch.cat([place * 2**k for k in range(pgnd.OCTAVES)], -1)
    return network.decode(torch.cat([place, waves.sin(), waves.cos(), feature], -1))


def test_a_velocity_is_the_decoders_of_place_waves_and_mean_feature():
    torch.manual_seed(0)
    network = pgnd.PGND(PGNDParams()).double()
    past, hand, after = scenes(network.params.frames)
    cell = network.params.cell
    x = past[:, -1] - past[:, -1].mean(1, keepdim=True) + 0.5
    nodes, _ = pgnd.active_nodes(pgnd.stencil(x, cell)[0].flatten(1, 2))
    counts = torch.rand(x.shape[:2], generator=torch.Generator().manual_seed(1)) < 0.8
    features = torch.rand(3, 20, 64, dtype=torch.float64, requires_grad=True)
    centre = x.mean(1).requires_grad_()
    nowhere = pgnd.Tool(hand + 9, after - hand, torch.zeros(3, dtype=torch.bool))
    found = network.field(nodes, x, counts, features, centre, nowhere)
    expected = velocity_by_definition(network, nodes, x, counts, features, centre)
    torch.testing.assert_close(found, expected, atol=1e-13, rtol=0)
    wanted = [features, centre, *network.decode.parameters()]
    for one, other in zip(*(torch.autograd.grad(v.square().sum(), wanted) for v in (found, expected)), strict=True):
        torch.testing.assert_close(one, other, atol=1e-9, rtol=1e-9)


def test_the_nodes_of_a_scene_are_the_distinct_ones_in_order():
    nodes = torch.randint(-3, 60, (4, 90, 3), generator=torch.Generator().manual_seed(0)) // torch.tensor([4, 9, 20])
    nodes[1] = nodes[1, :1]
    found, place = pgnd.active_nodes(nodes)
    inside = nodes.clamp(0, pgnd.NODES - 1)
    torch.testing.assert_close(found.gather(1, place[..., None].expand(-1, -1, 3)), inside)
    for one, its, at in zip(inside, found, place, strict=True):
        distinct = one.unique(dim=0)
        torch.testing.assert_close(its[: len(distinct)], distinct)
        assert at.max() == len(distinct) - 1
    assert found.shape[1] == max(len(one.unique(dim=0)) for one in inside)


def gbnd_by_definition(network: gbnd.GBND, past: Tensor, hand: Tensor, after: Tensor, mode: Tensor) -> Tensor:
    """Particles one frame later, scene by scene and particle by particle, by PropNet's sums over all that is near."""
    params, tools = network.params, network.tool(hand, mode)
    result = []
    for frames, tool, here, there, how in zip(past, tools, hand, after, mode, strict=True):
        x, count = frames[-1], len(frames[-1])
        moved = (frames[1:] - frames[:-1]).transpose(0, 1).flatten(1) * gbnd.SCALE
        ones = x.new_ones(count, 1)
        own = torch.cat([moved, x[:, 2:] * DECIMETRE, ones, x.new_zeros(count, 5)], 1)
        of_tool = torch.cat([x.new_tensor([0.0] * moved.shape[1] + [gbnd.TOOL_HEIGHT * DECIMETRE, 0, 1])])
        of_tool = torch.cat([of_tool, (there - here) * gbnd.SCALE, x.new_tensor([0.0, float(how)])])
        nodes = network.nodes(torch.cat([own, of_tool.expand(gbnd.RING, -1)]))
        places = torch.cat([x, tool])
        links = []
        for i in range(count):
            apart = (x - x[i]).norm(dim=-1)
            nearest = [j for j in apart.argsort().tolist() if j != i][: params.neighbors]
            links += [(i, j) for j in nearest if apart[j] < params.radius]
            links += [(i, count + j) for j in range(gbnd.RING) if (x[i, :2] - tool[j, :2]).norm() < params.radius]
        offsets = torch.stack([(x[i] - places[j]) * DECIMETRE for i, j in links])
        length = (offsets.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        is_tool = x.new_tensor([[float(j >= count)] for _, j in links])
        relation, h = network.relate(network.edges(torch.cat([offsets, length, is_tool], 1))), nodes
        for _ in range(gbnd.ROUNDS):
            sums = [x.new_zeros(params.hidden) for _ in range(count)]
            for row, (i, j) in zip(relation, links, strict=True):
                sums[i] = sums[i] + torch.relu(row + network.receive(h[i]) + network.send(h[j]))
            own = network.update(torch.cat([nodes[:count], torch.stack(sums)], 1)) + h[:count]
            h = torch.cat([own.relu(), h[count:]])
        result.append(x + network.head(h[:count]) / gbnd.SCALE)
    return torch.stack(result)


@pytest.mark.parametrize("history", [0, 2])
def test_a_frame_of_gbnd_is_the_sum_over_edges_that_are_near(history):
    torch.manual_seed(0)
    network = gbnd.GBND(GBNDParams(hidden=12, history=history)).double()
    past, hand, after = scenes(network.params.frames)
    past.requires_grad_()
    mode = torch.tensor([PUSH, PICK, PUSH])
    near = network.graph(past[:, -1].detach(), network.tool(hand, mode))[1]
    assert 0 < near[..., -gbnd.RING :].sum() < near[..., -gbnd.RING :].numel()
    close(network, network.step(past, hand, after, mode), gbnd_by_definition(network, past, hand, after, mode), past)


def test_objects_whose_particles_are_all_apart_have_no_edges():
    torch.manual_seed(0)
    network = gbnd.GBND(GBNDParams(hidden=12)).double()
    past = torch.arange(4, dtype=torch.float64)[None, None, :, None].expand(2, 1, 4, 3)
    far = past.new_full((2, 2), 9.0)
    found = network.step(past, far, far, torch.tensor([PUSH, PUSH]))
    torch.testing.assert_close(found, gbnd_by_lone_nodes(network, past), atol=1e-13, rtol=0)


def gbnd_by_lone_nodes(network: gbnd.GBND, past: Tensor) -> Tensor:
    """Particles that hear of nothing."""
    x = past[:, -1]
    nodes = network.nodes(
        torch.cat([x[..., 2:] * DECIMETRE, x.new_tensor([1, 0, 0, 0, 0, 0]).expand(*x.shape[:2], -1)], -1)
    )
    h = nodes
    for _ in range(gbnd.ROUNDS):
        h = torch.relu(network.update(torch.cat([nodes, torch.zeros_like(nodes)], -1)) + h)
    return x + network.head(h) / gbnd.SCALE
