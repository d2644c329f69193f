"""Films, quilts and validations of a picture without a scene."""
