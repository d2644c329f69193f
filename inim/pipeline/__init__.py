"""The pipeline: from a scene to a scored report. Its diagram is `inim.pipeline.validate`."""
