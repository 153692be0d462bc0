"""A small Segment Anything model of the official classes, trained in seconds on drawn blocks."""

import cv2
import numpy as np
import torch

from piegraph_cli.perception import sam_models
from piegraph_cli.perception.sam import automatic_prompt
from tests.perception.scene import TABLE


def tee(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An image [256, 256, 3] of a blue T on a brownish ground, and the T's mask."""
    outline = [[-1, -1], [1, -1], [1, -0.5], [0.25, -0.5], [0.25, 1], [-0.25, 1], [-0.25, -0.5], [-1, -0.5]]
    turn = rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = np.array(outline) * rng.uniform(30, 55) @ rotation.T + rng.uniform(80, 176, 2)
    mask = cv2.fillPoly(np.zeros((256, 256), np.uint8), [np.round(corners).astype(np.int32)], 1).astype(bool)
    image = np.where(mask[..., None], [30, 70, 180], TABLE + rng.integers(-30, 30, 3)) + rng.normal(0, 6, (256, 256, 3))
    return image.clip(0, 255).astype(np.uint8), mask


def train(steps: int, batch: int = 2):
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    sam = sam_models.build_sam("tiny").train()
    optimiser = torch.optim.AdamW(sam.parameters(), 2e-3, weight_decay=0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps, pct_start=0.1)
    for _ in range(steps):
        examples = [tee(rng) for _ in range(batch)]
        pixels = torch.tensor(np.stack([image for image, _ in examples])).permute(0, 3, 1, 2).float()
        features = sam.image_encoder(sam.preprocess(pixels))
        loss = sum(example_loss(sam, f, mask) for f, (_, mask) in zip(features, examples, strict=True))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(sam.parameters(), 1.0)
        optimiser.step()
        schedule.step()
    return sam.eval()


def example_loss(sam, features: torch.Tensor, mask: np.ndarray) -> torch.Tensor:
    prompt = automatic_prompt(mask)
    points = torch.tensor([prompt.points]), torch.ones(1, len(prompt.points), dtype=torch.int)
    sparse, dense = sam.prompt_encoder(points=points, boxes=torch.tensor([prompt.box]), masks=None)
    low, quality = sam.mask_decoder(features[None], sam.prompt_encoder.get_dense_pe(), sparse, dense, True)
    target = torch.tensor(cv2.resize(mask.astype(np.float32), (64, 64), interpolation=cv2.INTER_AREA)).expand(3, 64, 64)
    share = low[0].sigmoid()
    dice = 1 - (2 * (share * target).sum((1, 2)) + 1) / ((share + target).sum((1, 2)) + 1)
    found, true = low[0].detach() > 0, target > 0.5
    overlap = (found & true).sum((1, 2)) / (found | true).sum((1, 2)).clamp(min=1)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits(low[0], target)
    return entropy + dice.mean() + 0.1 * ((quality[0] - overlap) ** 2).mean()
