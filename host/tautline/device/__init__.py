"""The actuator board: messages, transport, firmware update."""
