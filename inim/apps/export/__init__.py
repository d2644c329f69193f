"""Virtual displays, PDFs, sub-aperture views and quilts of EIAs."""
