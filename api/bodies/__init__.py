"""Bodies of requests and answers: plain models, by which the service and its Python client understand each other.

They load nothing that makes an answer, so that a script on another machine pays for the models alone.
"""
