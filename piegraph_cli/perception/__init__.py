"""From images to geometry: object masks, hand keypoints, point clouds and contact. Works on arrays, reads no files."""
