"""Messages: ROS 2 messages as the bytes on the wire (CDR), to and from what the controller works with. No ROS needed.

The node and the replay read the same bytes with the same code, so that both see the same numbers.
"""
