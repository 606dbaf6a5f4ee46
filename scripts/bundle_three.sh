#!/usr/bin/env bash
# Makes dopslam/report/assets/three.bundle.js: what the replay uses of three.js, as one script that needs no network.
# Needs node and npm; run it only to change the version or the list below.
set -euo pipefail
target="$(cd "$(dirname "$0")/.." && pwd)/dopslam/report/assets/three.bundle.js"
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent three@0.170 esbuild
cat > entry.js <<'JS'
export { Scene, PerspectiveCamera, WebGLRenderer, Color, Group, Mesh, MeshBasicMaterial, MeshLambertMaterial, LineBasicMaterial, LineDashedMaterial,
  LineSegments, Line, BufferGeometry, BufferAttribute, Float32BufferAttribute, SphereGeometry, ConeGeometry, AmbientLight, DirectionalLight,
  GridHelper, DoubleSide, Vector3, Matrix4, Box3, Quaternion, EdgesGeometry, Points, PointsMaterial } from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
JS
npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE --outfile=three.bundle.js
{
  echo "/* three.js 0.170 (MIT License, Copyright © 2010-2024 three.js authors), with OrbitControls; made by scripts/bundle_three.sh */"
  cat three.bundle.js
} > "$target"
