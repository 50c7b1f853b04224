"""A simulated bench that shares no code with the product: its recordings and a key, to judge `sawbench diagnose` by.

Of the product it imports the recording (`sawbench.bench.recording`) and the writer of its files
(`sawbench.storage.reader.write_recording`), and nothing else; a test holds it to that. Start with `__main__.py`.
"""
