"""The image service: pose in, image out, blocking, with truth.

One thread renders, in the order in which requests came; each client has a thread of its own that reads one request,
waits for its answer and sends it. A client has thus at most one request under way, and the queue is never longer than
the list of clients. No answer depends on who asked before: what a request leaves out is as the scene has it.
"""
