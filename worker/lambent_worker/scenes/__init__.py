"""Readers of capture folders: every layout becomes one `SceneManifest`, every manifest one `Scene`.

`detect.describe_scene` reads names, headers and cameras; `lights.select_lights` chooses what is trained on;
`load.load_scene` decodes the pictures (and alone needs torch).
"""
