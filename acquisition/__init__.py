"""acquisition: samples to and from one MCAP stream; it knows nothing of maps.

`stream_writer` writes samples, `byte_source` and `stream_reader` hand them on again in one
defined order, live or offline; `recorder` records all sources at once, as `config` says, and
`health` tells how they are doing; `recovery` and `editing` make new recordings of old ones;
`clock` and `device_clock` say what time it was. The messages are ROS 2 messages, so that other
tools open them.
"""

# Start-up compares this with "terravibe" to notice another distribution's `acquisition`.
DISTRIBUTION = "terravibe"
