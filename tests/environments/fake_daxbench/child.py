"""A fake far end of the bridge: answers by the protocol, written out by hand, until it does what FAULT says."""

import base64
import json
import os
import struct
import sys
import time

FAULT = os.environ.get("FAULT", "")
POINTS = [[0.4 + 0.004 * i, 0.01, 0.5 + 0.02 * (i % 2)] for i in range(60)]


def array(points, dtype="<f4"):
    numbers = [number for point in points for number in point]
    data = base64.b64encode(struct.pack(f"<{len(numbers)}f", *numbers)).decode()
    return {"dtype": dtype, "shape": [len(points), 3], "data": data}


def nested(frames, points):
    packed = array(points * frames)
    return packed | {"shape": [frames, len(points), 3]}


def say(reply):
    print(json.dumps(reply), flush=True)


def answer(request):
    if request["do"] == "reset":
        return {"rest": array(POINTS), "particles": array(POINTS)}
    if request["do"] == "step":
        count = request["frames"] + 1
        return {"frames": nested(count, POINTS), "tool": array([request["start"]] * count), "grasped": False}
    if request["do"] == "get_state":
        return {"state": {"x": array(POINTS), "padding": nested(20000, POINTS[:4])}}
    return {"particles": array(POINTS)}


def spoil(reply):
    """The reply to a step with one thing wrong."""
    moved = [[0.5, 0.01, float("nan")], *POINTS[1:]]
    count = reply["tool"]["shape"][0]
    return {
        "nan-tool": lambda: reply | {"tool": array([[0.5, float("nan"), 0.5]] * count)},
        "nan-particles": lambda: reply | {"frames": nested(count, moved)},
        "shape": lambda: reply | {"frames": nested(count, POINTS[:-1])},
        "short": lambda: reply | {"tool": reply["tool"] | {"shape": [10**9, 10**9, 3]}},
        "negative": lambda: reply | {"tool": reply["tool"] | {"shape": [-1, 3]}},
        "object": lambda: reply | {"tool": reply["tool"] | {"dtype": "|O"}},
        "list-dtype": lambda: reply | {"tool": reply["tool"] | {"dtype": ["<f4"]}},
        "base64": lambda: reply | {"tool": reply["tool"] | {"data": "?!"}},
        "lacks": lambda: {"id": reply["id"], "frames": reply["frames"]},
        "grasped": lambda: reply | {"grasped": 1},
        "id": lambda: reply | {"id": 77},
        "list": lambda: [reply],
    }[FAULT]()


def fail():
    """What breaks without any reply."""
    if FAULT == "crash":
        print("line before\nthe reason", file=sys.stderr, flush=True)
        os._exit(3)
    if FAULT == "killed":
        os.kill(os.getpid(), 9)
    if FAULT == "garbage":
        print("\x1b[2J I am no JSON", flush=True)
    if FAULT == "nesting":
        print("[" * 100_000, flush=True)
    if FAULT == "two":
        print("{}\n{}", flush=True)
    if FAULT == "drip":
        while True:
            print(" ", end="", flush=True)
            time.sleep(0.01)
    if FAULT == "closes":
        os.close(1)
    if FAULT == "oversize":
        os.write(1, b" " * (65 * 2**20))
    time.sleep(600)


PINNED = {"jax": "0.4.13", "jaxlib": "0.4.13", "numpy": "1.26.4", "scipy": "1.12.0", "gym": "0.25.2", "optax": "0.1.7"}
FOUND = PINNED | {"python": "3.11.7", "opencv-python-headless": "4.10.0.84", "trimesh": "4.12.2"}
PROBLEMS = {
    "no-jax": ("ModuleNotFoundError: No module named 'jax'", FOUND | {"jax": None}),
    "new-jax": ("ImportError: cannot import name 'KeyArray'\x1b[2J", FOUND | {"jax": "0.4.30", "numpy": "2.1.0"}),
    "new-python": ("ModuleNotFoundError: No module named 'jax'", FOUND | {"jax": None, "python": "3.12.1"}),
    "old-commit": ("AttributeError: no FoldTshirtEnv", FOUND),
    "wordless": (7, FOUND),
}
if FAULT == "early":
    sys.exit("No module named 'jax'")
hello = {"id": 0, "protocol": 2 if FAULT == "protocol" else 1, "task": sys.argv[1]}
if FAULT in PROBLEMS:
    hello["problem"], hello["found"] = PROBLEMS[FAULT]
say(hello)
for line in sys.stdin:
    asked = json.loads(line)
    reply = {"id": asked["id"], **answer(asked)}
    if FAULT == "nan-reset":
        say(reply | {"particles": array([[float("inf"), 0, 0], *POINTS[1:]])})
    elif FAULT == "deaf" and asked["do"] == "get_state":
        say(reply)
        time.sleep(600)
    elif asked["do"] != "step" or not FAULT or FAULT == "deaf":
        say(reply)
    elif FAULT in ("crash", "killed", "garbage", "nesting", "two", "drip", "closes", "oversize", "hang"):
        fail()
    else:
        say(spoil(reply))
