/** The mesh in 3-D: one surface and one set of cell edges for each component, on shared vertices. */
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Mesh } from "./api";

const COLOURS = [0x4477aa, 0xccbb44, 0x228833, 0xee6677, 0x66ccee, 0xaa3377];
const ABSENT = 0xffffffff; // fourth vertex of a triangle

export class View {
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(35, 1, 0.01, 1e4);
  private readonly controls: OrbitControls;
  private positions = new THREE.BufferAttribute(new Float32Array(0), 3);
  private parts: THREE.Group[] = [];

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.listenToKeyEvents(canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.camera.up.set(0, 0, 1);
    this.camera.add(new THREE.DirectionalLight(0xffffff, 2));
    this.scene.add(this.camera, new THREE.AmbientLight(0xffffff, 1));
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  show(mesh: Mesh, components: number): void {
    for (const part of this.parts) {
      part.traverse((object) => { if (object instanceof THREE.Mesh || object instanceof THREE.LineSegments) { object.geometry.dispose(); object.material.dispose(); } });
      this.scene.remove(part);
    }
    this.positions = new THREE.BufferAttribute(Float32Array.from(mesh.vertices.flat()), 3);
    this.parts = Array.from({ length: components }, (_, owner) => {
      const triangles: number[] = [], edges: number[] = [];
      mesh.cells.forEach((cell, index) => {
        if (mesh.cell_owner[index] !== owner) return;
        const corners = cell.filter((vertex) => vertex !== ABSENT);
        for (let k = 2; k < corners.length; k++) triangles.push(corners[0], corners[k - 1], corners[k]);
        corners.forEach((vertex, k) => edges.push(vertex, corners[(k + 1) % corners.length]));
      });
      const geometry = (index: number[]) => new THREE.BufferGeometry().setAttribute("position", this.positions).setIndex(index);
      const material = new THREE.MeshLambertMaterial({ color: COLOURS[owner % COLOURS.length], flatShading: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
      const lines = new THREE.LineBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.3 });
      const part = new THREE.Group().add(new THREE.Mesh(geometry(triangles), material), new THREE.LineSegments(geometry(edges), lines));
      part.traverse((object) => { object.frustumCulled = false; });
      this.scene.add(part);
      return part;
    });
    const box = new THREE.Box3().setFromBufferAttribute(this.positions);
    const centre = box.getCenter(new THREE.Vector3()), size = box.getSize(new THREE.Vector3()).length();
    this.camera.near = size / 1000;
    this.camera.far = size * 20;
    this.camera.position.copy(centre).add(new THREE.Vector3(-0.9, -1, 0.7).multiplyScalar(size));
    this.controls.target.copy(centre);
    this.controls.update();
    this.draw();
  }

  move(vertices: Float64Array): void {
    (this.positions.array as Float32Array).set(vertices);
    this.positions.needsUpdate = true;
    this.draw();
  }

  setVisible(component: number, visible: boolean): void { this.parts[component].visible = visible; this.draw(); }

  private draw(): void {
    const { clientWidth, clientHeight } = this.canvas;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / Math.max(clientHeight, 1);
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
  }
}
