"""What `--json` prints, held against the models that docs/json.md is made from: every test that asks for JSON does."""

import functools
import json
from typing import Any, Union

from pydantic import TypeAdapter

from piegraph_cli.commands.results import Envelope, results_of


@functools.cache
def _result(command: str) -> TypeAdapter:
    return TypeAdapter(Union[results_of(command)])  # noqa: UP007


def _refused(word: str) -> None:
    raise ValueError(f"{word} is no JSON")


def checked(text: str) -> dict[str, Any]:
    """The envelope. Raises ValidationError where it is not as the models say."""
    found = json.loads(text, parse_constant=_refused)
    Envelope.model_validate_json(text, strict=True)
    if found["result"] is not None:
        _result(found["command"]).validate_json(json.dumps(found["result"]), strict=True)
    return found
