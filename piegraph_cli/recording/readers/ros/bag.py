"""Bags of ROS 1 and ROS 2 as streams of messages: opened one at a time, read forward, never whole in memory."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from piegraph_cli.errors import DataError, MissingError
from piegraph_cli.recording.folders import BAGS, entries_of, is_ros2_folder

AGAIN = {
    ".bag": "`rosbag reindex` it where it was cut short, or record again",
    ".db3": "`ros2 bag reindex` it where it was cut short, or record again",
    ".mcap": "`mcap recover` it where it was cut short, or record again",
}


def bags_of(sequence: Path) -> list[Path]:
    """The bags of a sequence: the file itself, the folder that ROS 2 wrote, or those in the folder, sorted by name."""
    if sequence.is_file() or is_ros2_folder(sequence):
        return [sequence]
    return sorted(p for p in entries_of(sequence) if is_ros2_folder(p) or (p.is_file() and p.suffix in BAGS))


def messages(bag: Path, wanted: Callable[[str, str], bool]) -> Iterator[tuple[str, str, float, Any]]:
    """Topic, type, time of receipt (s) and content of the messages of wanted (topic, type), in the order of receipt.

    Raises `DataError` naming the bag and how far it could be read, `MissingError` without the package that reads bags.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        hint = "pip install 'piegraph[ros]', or pip install rosbags"
        raise MissingError("reading ROS bags needs the package rosbags", str(bag), hint) from None
    done, last = 0, ""
    try:
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            chosen = [c for c in reader.connections if wanted(c.topic, c.msgtype)]
            for connection, time, raw in reader.messages(chosen) if chosen else ():
                last = connection.topic
                yield last, connection.msgtype, time / 1e9, reader.deserialize(raw, connection.msgtype)
                done += 1
    except Exception as error:  # the package raises whatever broken bytes lead it to
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        after = f" after {done} messages, at topic {last}" if last else ""
        hint = AGAIN.get(bag.suffix, AGAIN[".db3"])
        raise DataError(f"the bag cannot be read{after}: {reason}", str(bag), hint) from None


class Stream:
    """The messages of one topic, by number. Going forward reads on; going back reads from the start again."""

    def __init__(self, bag: Path, topic: str):
        self.bag, self.topic = bag, topic
        self._rest: Iterator[tuple[str, str, float, Any]] = iter(())
        self._at, self._message = -1, None

    def __getitem__(self, number: int) -> Any:
        if self._at < 0 or number < self._at:
            self._rest, self._at = messages(self.bag, lambda topic, _: topic == self.topic), -1
        while self._at < number:
            found = next(self._rest, None)
            if found is None:
                raise DataError(f"topic {self.topic} ends before message {number}", str(self.bag), "was it changed?")
            self._at, self._message = self._at + 1, found[3]
        return self._message

    def where(self, number: int) -> str:
        """How a message is called in errors."""
        return f"{self.bag}, topic {self.topic}, message {number}"
