"""Parts of pictures and pages as plain arrays, and their drawing without a graphics card."""
