/* A Python module that makes calls ready: a function of record.c, bound to the arrays it reads and writes,
   becomes a Python function that costs little more than what it does. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

typedef void (*Function)(const void *job, long first, long end);

enum { MOST = 16 };

typedef struct {
    Function function;
    const void *job;
    int unlocked;
    Py_ssize_t inputs, outputs;
    PyArrayObject *input[MOST], *output[MOST];
    PyTypeObject *type;
    PyObject *kept;
} Call;

static int put(PyArrayObject *to, npy_intp i, PyObject *value) {
    double x;
    if (PyFloat_Check(value))
        x = PyFloat_AS_DOUBLE(value);
    else if (PyLong_Check(value)) {
        x = PyLong_AsDouble(value);
        if (x == -1 && PyErr_Occurred()) {
            PyErr_Clear();
            return 0;
        }
    } else
        return 0;
    if (PyArray_TYPE(to) == NPY_DOUBLE)
        ((double *)PyArray_DATA(to))[i] = x;
    else
        ((float *)PyArray_DATA(to))[i] = (float)x;
    return 1;
}

/* Numbers into an array of as many: 1 if it could be done, 0 if they are no such numbers, -1 for an exception. */
static int take(PyObject *value, PyArrayObject *to) {
    const int axes = PyArray_NDIM(to);
    if (PyArray_CheckExact(value)) {
        PyArrayObject *from = (PyArrayObject *)value;
        const int type = PyArray_TYPE(from);
        if (!PyArray_SAMESHAPE(from, to)) return 0;
        if (type == PyArray_TYPE(to) && PyArray_ISCARRAY_RO(from)) {
            memcpy(PyArray_DATA(to), PyArray_DATA(from), PyArray_NBYTES(to));
            return 1;
        }
        if (!PyTypeNum_ISFLOAT(type) && !PyTypeNum_ISINTEGER(type)) return 0;
        return PyArray_CopyInto(to, from) < 0 ? -1 : 1;
    }
    if (axes == 0) return put(to, 0, value);
    if (axes > 1 || !(PyList_CheckExact(value) || PyTuple_CheckExact(value))) return 0;
    const Py_ssize_t size = PyArray_DIM(to, 0);
    if (PySequence_Fast_GET_SIZE(value) != size) return 0;
    for (Py_ssize_t i = 0; i < size; i++)
        if (!put(to, i, PySequence_Fast_GET_ITEM(value, i))) return 0;
    return 1;
}

static PyObject *copy(PyArrayObject *from) {
    if (PyArray_NDIM(from) == 0) return PyArray_Scalar(PyArray_DATA(from), PyArray_DESCR(from), NULL);
    PyObject *to = PyArray_SimpleNew(PyArray_NDIM(from), PyArray_DIMS(from), PyArray_TYPE(from));
    if (to) memcpy(PyArray_DATA((PyArrayObject *)to), PyArray_DATA(from), PyArray_NBYTES(from));
    return to;
}

static PyObject *called(PyObject *self, PyObject *const *values, Py_ssize_t count) {
    Call *c = PyCapsule_GetPointer(self, NULL);
    if (!c) return NULL;
    if (count != c->inputs) return PyErr_Format(PyExc_TypeError, "%zd values for %zd arrays", count, c->inputs);
    for (Py_ssize_t i = 0; i < count; i++) {
        if (values[i] == Py_None) continue;
        const int taken = take(values[i], c->input[i]);
        if (taken < 0) return NULL;
        if (!taken) Py_RETURN_NOTIMPLEMENTED;
    }
    if (!c->function) { /* only to be read */
    } else if (c->unlocked) {
        Py_BEGIN_ALLOW_THREADS
        c->function(c->job, 0, 1);
        Py_END_ALLOW_THREADS
    } else
        c->function(c->job, 0, 1);
    if (!c->outputs) Py_RETURN_NONE;
    if (!c->type) return copy(c->output[0]);
    PyObject *told = c->type->tp_alloc(c->type, c->outputs);
    for (Py_ssize_t i = 0; told && i < c->outputs; i++) {
        PyObject *part = copy(c->output[i]);
        if (part)
            PyTuple_SET_ITEM(told, i, part);
        else
            Py_CLEAR(told);
    }
    return told;
}

static PyMethodDef call_method = {"call", (PyCFunction)(void (*)(void))called, METH_FASTCALL, "see sigmax.native.calls"};

static void forget(PyObject *capsule) {
    Call *c = PyCapsule_GetPointer(capsule, NULL);
    for (Py_ssize_t i = 0; i < c->inputs; i++) Py_DECREF(c->input[i]);
    for (Py_ssize_t i = 0; i < c->outputs; i++) Py_DECREF(c->output[i]);
    Py_XDECREF(c->type);
    Py_XDECREF(c->kept);
    PyMem_Free(c);
}

/* References to the arrays of a tuple: how many, or -1 for an exception. */
static Py_ssize_t hold(PyObject *arrays, PyArrayObject **held) {
    const Py_ssize_t count = PyTuple_GET_SIZE(arrays);
    if (count > MOST) {
        PyErr_Format(PyExc_ValueError, "%zd arrays, at most %d", count, MOST);
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *array = PyTuple_GET_ITEM(arrays, i);
        if (!PyArray_Check(array) || !PyArray_ISCARRAY_RO((PyArrayObject *)array)) {
            PyErr_SetString(PyExc_TypeError, "arrays of numbers, row by row without gaps");
            return -1;
        }
    }
    for (Py_ssize_t i = 0; i < count; i++) held[i] = (PyArrayObject *)Py_NewRef(PyTuple_GET_ITEM(arrays, i));
    return count;
}

static PyObject *ready(PyObject *self, PyObject *arguments) {
    PyObject *inputs, *outputs, *type, *kept;
    Py_ssize_t function, job;
    int unlocked;
    if (!PyArg_ParseTuple(arguments, "nnO!O!OOp", &function, &job, &PyTuple_Type, &inputs, &PyTuple_Type, &outputs,
                          &type, &kept, &unlocked))
        return NULL;
    const int tuple = PyType_Check(type) && PyType_IsSubtype((PyTypeObject *)type, &PyTuple_Type);
    if (type != Py_None && !tuple) return PyErr_Format(PyExc_TypeError, "a type of tuples, not %R", type);
    Call *c = PyMem_Calloc(1, sizeof *c);
    if (!c) return PyErr_NoMemory();
    PyObject *capsule = PyCapsule_New(c, NULL, forget);
    if (!capsule) {
        PyMem_Free(c);
        return NULL;
    }
    c->function = (Function)function, c->job = (const void *)job, c->unlocked = unlocked;
    c->type = tuple ? (PyTypeObject *)Py_NewRef(type) : NULL;
    c->kept = Py_NewRef(kept);
    Py_ssize_t count = hold(inputs, c->input);
    if (count >= 0) c->inputs = count, count = hold(outputs, c->output);
    if (count >= 0) c->outputs = count;
    PyObject *call = count < 0 ? NULL : PyCFunction_New(&call_method, capsule);
    Py_DECREF(capsule);
    return call;
}

static PyMethodDef methods[] = {{"ready", ready, METH_VARARGS, "see sigmax.native.calls"}, {0}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "call", NULL, -1, methods};

PyMODINIT_FUNC PyInit_call(void) {
    import_array();
    return PyModule_Create(&module);
}
