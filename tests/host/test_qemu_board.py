"""The loop that serves the second port's host and sim links, without the machine."""

from __future__ import annotations

import json
import socket
from types import SimpleNamespace
from typing import Any

from tools.qemu.board import World, serve


def test_a_sim_link_that_gets_the_number_of_a_host_that_hung_up() -> None:
    line, sim = socket.create_server(("127.0.0.1", 0)), socket.create_server(("127.0.0.1", 0))
    machine, other = socket.socketpair()
    host = socket.create_connection(line.getsockname())
    world: Any = World.__new__(World)
    world.machine = SimpleNamespace(line=machine, receive=lambda: None)
    world.client, world.quit, world.realtime = line.accept()[0], False, False

    def request(_: str) -> dict[str, Any]:
        world.quit = True
        return {"attached": world.client is not None}

    world.request = request
    with line, sim, machine, other, socket.create_connection(sim.getsockname()) as link:
        link.sendall(b"state\n")
        host.close()  # both are there before the loop looks
        serve(world, line, sim, 0)
        assert json.loads(link.recv(100)) == {"attached": False}
