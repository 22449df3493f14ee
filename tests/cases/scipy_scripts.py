# ruff: noqa: ARG001, ARG002, D101, D102, E731, RET504, RUF059 - as people write and copy them
# fmt: off
"""Right-hand sides as in scipy's manual and in answers on the web, in the style in which they are written there."""

import math
from math import cos, exp, pi, sin

import numpy as np
from numpy import array, zeros

g, L, c_d = 9.81, 1.0, 0.05


# scipy's manual
def exponential_decay(t, y): return -0.5 * y
def upward_cannon(t, y): return [y[1], -0.5]
def hit_ground(t, y): return y[0]
hit_ground.terminal = True
hit_ground.direction = -1
def apex(t, y): return y[1]
def lotkavolterra(t, z, a, b, c, d):
    x, y = z
    return [a*x - b*x*y, -c*y + d*x*y]
def deriv_vec(t, y):
    A = np.array([[-0.25 + 0.14j, 0, 0.33], [0, -0.2, 0], [0, 0, -0.1]]).real
    return A @ y
def pend(t, y, b, c):
    theta, omega = y
    dydt = [omega, -b*omega - c*np.sin(theta)]
    return dydt


# classics
def lorenz(t, xyz, *, s=10, r=28, b=2.667):
    x, y, z = xyz
    x_dot = s*(y - x)
    y_dot = r*x - y - x*z
    z_dot = x*y - b*z
    return np.array([x_dot, y_dot, z_dot])
def rossler(t, y, a, b, c): return np.array([-y[1] - y[2], y[0] + a*y[1], b + y[2]*(y[0] - c)])
def vdp(t, y, mu): return [y[1], mu*(1 - y[0]**2)*y[1] - y[0]]
def robertson(t, y):
    r1, r2, r3 = 0.04*y[0], 1e4*y[1]*y[2], 3e7*y[1]**2
    return [-r1 + r2, r1 - r2 - r3, r3]
def brusselator(t, y, A, B): return np.array([A + y[0]**2*y[1] - (B + 1)*y[0], B*y[0] - y[0]**2*y[1]])
def sir(t, y, N, beta, gamma):
    S, I, R = y
    dSdt = -beta*S*I/N
    dIdt = beta*S*I/N - gamma*I
    dRdt = gamma*I
    return dSdt, dIdt, dRdt
def fitzhugh(t, state, a=0.7, b=0.8, tau=12.5):
    v, w = state
    I = 0.5 if not isinstance(t, str) else 0
    return np.array([v - v**3/3 - w + I, (v + a - b*w)/tau])
def double_pendulum(t, state):
    dydx = np.zeros_like(state)
    dydx[0] = state[1]
    delta = state[2] - state[0]
    den1 = 2*L - L*cos(delta)*cos(delta)
    dydx[1] = (L*state[1]*state[1]*sin(delta)*cos(delta) + g*sin(state[2])*cos(delta) + L*state[3]*state[3]*sin(delta) - 2*g*sin(state[0]))/den1
    dydx[2] = state[3]
    dydx[3] = (-L*state[3]*state[3]*sin(delta)*cos(delta) + 2*g*sin(state[0])*cos(delta) - 2*L*state[1]*state[1]*sin(delta) - 2*g*sin(state[2]))/den1
    return dydx
def double_pendulum_matrix(t, s):
    a, b, va, vb = s
    d = a - b
    M = np.array([[2.0, np.cos(d)], [np.cos(d), 1.0]])
    f = np.array([-vb**2*np.sin(d) - 2*g*np.sin(a), va**2*np.sin(d) - g*np.sin(b)])
    return np.concatenate(([va, vb], np.linalg.solve(M, f)))
def kepler(t, w):
    r, v = w[:2], w[2:]
    return np.hstack((v, -r/np.linalg.norm(r)**3))
def cannonball(t, u):
    x, vx, y, vy = u
    speed = math.hypot(vx, vy)
    return vx, -c_d*speed*vx, vy, -c_d*speed*vy - g
def landed(t, u): return u[2]
landed.terminal, landed.direction = True, -1


# loops, item assignment, helpers
def coupled_springs(t, y, N):
    dydt = np.zeros(2*N)
    for i in range(N):
        left = y[i - 1] if i > 0 else 0.0
        right = y[i + 1] if i < N - 1 else 0.0
        dydt[i] = y[N + i]
        dydt[N + i] = left - 2*y[i] + right
    return dydt
def heat_loop(t, u):
    n = len(u)
    dudt = np.empty(n)
    h = 1.0/(n - 1)
    dudt[0] = dudt[-1] = 0
    for i in range(1, n - 1):
        dudt[i] = 0.1*(u[i - 1] - 2*u[i] + u[i + 1])/h**2
    return dudt
def heat_slices(t, u):
    d = zeros(u.shape)
    d[1:-1] = (u[2:] - 2*u[1:-1] + u[:-2])*8
    return d
def advection_roll(t, u): return -(u - np.roll(u, 1))*3
def gray_scott(t, y):
    u, v = y.reshape(2, -1)
    lap = lambda a: np.roll(a, 1) + np.roll(a, -1) - 2*a
    uvv = u*v*v
    return np.concatenate([0.16*lap(u) - uvv + 0.06*(1 - u), 0.08*lap(v) + uvv - 0.122*v])
def kuramoto(t, theta, K):
    omega = np.linspace(-1, 1, 5)
    return omega + K/5*np.sum(np.sin(theta[None, :] - theta[:, None]), axis=1)
def acceleration(r, m):
    a = np.zeros_like(r)
    for i in range(len(r)):
        for j in range(len(r)):
            if i != j:
                d = r[j] - r[i]
                a[i] += m[j]*d/np.linalg.norm(d)**3
    return a
def three_bodies(t, y, m):
    r, v = y.reshape(2, 3, 2)
    return np.concatenate((v.ravel(), acceleration(r, m).flatten()))
def three_bodies_broadcast(t, y):
    r, v = y.reshape(2, 3, 2)
    d = r[None] - r[:, None]
    cube = (np.sum(d**2, axis=-1) + np.eye(3))**1.5
    return np.r_[v.ravel(), np.sum(d/cube[..., None], axis=1).ravel()]


# branches, saturation, drives
def predator_where(t, y):
    x, p = y
    eaten = np.where(x > 0.3, 0.8*x*p, 0.0)
    return [x*(1 - x) - eaten, 0.5*eaten - 0.2*p]
tt = np.linspace(0, 3, 301)
ff = np.sin(2*pi*(0.5 + 0.4*tt)*tt)
def chirped(t, y):
    F = np.interp(t, tt, ff)
    return [y[1], F - 4*y[0] - 0.2*y[1]]
def force_curve(t, y): return [y[1], -np.interp(y[0], [-2, -1, 0, 1, 2], [-5, -1, 0, 1, 5])]
def saturated(t, x):
    u = np.clip(-4*x[0] - x[1], -1, 1)
    return np.array([x[1], u])
def step_input(t, y): return (np.heaviside(t - 1, 0.5) - y)/0.3
def square_wave(t, y):
    s = 1.0 - 2.0*(np.floor(2*t) % 2)
    return [s - y[0]]
def dosing(t, c): return -0.7*c + 2.0*np.maximum(0.0, 1 - np.mod(t, 1.5)/0.3)
def relu(t, y): return [max(0.0, y[1] - 0.2) - y[0], min(y[0], 1) - 0.5*y[1]]
def diode(t, v):
    i_d = 1e-3*np.expm1(v[0]/0.3)
    return [(sin(2*pi*t) - v[0]) - i_d]
def decades(t, y): return np.array([-np.log10(1 + y[0]**2), exp(-y[1])])
class Motor:
    def __init__(self, k): self.k = k
    def rhs(self, t, y): return [y[1], -self.k*y[0] - math.tanh(y[1])]
motor = Motor(3.0)
A3 = array([[0, 1, 0], [0, 0, 1], [-1, -2, -1.5]])
linear_system = lambda t, x, A, b: A.dot(x) + b*np.cos(t)
thermostat_a = lambda t, y: [-0.1*(y[0] - 20) + 2*np.where(np.sin(3*t) > 0, 1, 0)]


# these are refused, and told what to write
def odeint_style(y, t, k): return -k*y
def branching(t, y):
    if y[0] > 0.5:
        return [-y[0]]
    return [-2*y[0]]
def transformed(t, y): return np.fft.fft(y).real
