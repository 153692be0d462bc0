"""Cameras of a made-up make: they see a wall whose grey tells the number of the frame, and how far it is which camera it
is, at the rate that is asked for."""

import math
import time

import numpy as np

from piegraph_cli.capture.cameras import DepthCamera, Mode, Shot
from piegraph_cli.errors import DataError
from piegraph_cli.recording.camera import Camera


class MadeUp(DepthCamera):
    def __init__(self, serial: str, stops_after: int | None = None, skips: tuple[int, ...] = (), delay: float = 0.0):
        super().__init__()
        self.serial, self.stops_after, self.skips, self.delay = serial, stops_after, skips, delay
        self.running, self.number = False, 0

    def start(self, mode: Mode) -> Camera:
        self.mode, self.running = mode, True
        self.begin = math.floor(time.time() * mode.fps) / mode.fps  # all in phase, as cameras that are synchronised
        K = np.array([[float(mode.width), 0, mode.width / 2], [0, mode.width, mode.height / 2], [0, 0, 1]])
        return Camera(self.serial, mode.width, mode.height, K, np.zeros(5), np.eye(4))

    def read(self, timeout: float) -> Shot:
        self.number += 1
        while self.number in self.skips:
            self.number += 1
        if self.number == self.stops_after:
            raise DataError(f"camera {self.serial} has stopped delivering", hint="check the cable")
        stamp = self.begin + self.number / self.mode.fps
        time.sleep(max(0.0, stamp - time.time()))
        size = (self.mode.height, self.mode.width)
        away = 900 + sum(self.serial.encode()) % 50
        return Shot(
            stamp + self.delay, np.full((*size, 3), self.number % 200, np.uint8), np.full(size, away, np.uint16)
        )

    def stop(self) -> None:
        self.running = False
