"""The engine below the generators: which cell of a picture each panel pixel's ray meets first."""
