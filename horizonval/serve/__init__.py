"""The image service: pose in, image out, blocking, with truth.

One thread renders, in the order of the requests; each client has a thread that reads one request,
waits for its answer and sends it. So a client has at most one request under way. No answer depends on earlier
requests: missing keys come from the scene.
"""
