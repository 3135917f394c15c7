"""SpotLight as a service: REST, jobs that survive, server-sent events, and a page.

Three kinds of process share one data folder::

    API (uvicorn)   answers at once: reads and writes the job store, never computes a pixel
    worker          one a model: claims jobs, drains `Relighter.start`, writes results
    studio          decodes uploads, composes scenes, sketches shadows, converts pictures

Each is a process, not a thread: Python's lock would let a relight's array work hold up answers of
microseconds, a decoder that runs wild can be killed, and memory can be bounded.

`spotlight_service.app.create_app` makes the application, `spotlight_service.client` talks to one.
Nothing is imported here: workers need no web framework, and clients no engine.
"""
