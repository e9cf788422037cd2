"""The machine in space: sizes, pose, shapes and colours, without a browser; `canvas` brings them to one."""
