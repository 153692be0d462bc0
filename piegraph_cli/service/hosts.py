"""Whom a server on this machine answers: who asks for it by an address or this machine's name, not by a website's."""

import ipaddress
import socket


def is_ours(host: str, listens: str) -> bool:
    """Whether a Host header names an address, this machine, or what is listened on: no name that a website chose."""
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    if name.lower() in ("localhost", listens.lower(), socket.gethostname().lower()):
        return True
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True
